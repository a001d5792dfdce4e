"""One drive over SDO: can it do the job, its scalings, its protection, its PDO maps."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from typing import Any

from invid.config import AxisConfig, CellConfig
from invid.errors import BusError, DriveError
from invid.planning.stopping_distance import StoppingFacts
from invid.wording.sentence import sentence
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.access import Access, ObjectError, ReadRefused, WriteRefused
from invid_drivers.cia402.cycle_requests import BUSY_S, NOT_NOW
from invid_drivers.cia402.journal import Journal
from invid_drivers.cia402.limits import EffectiveLimits
from invid_drivers.cia402.link import Link, SdoError
from invid_drivers.cia402.objects import NodeAxis, Object
from invid_drivers.cia402.protection import Protection
from invid_drivers.cia402.restoration import restore
from invid_drivers.cia402.standing.stopping import event_timer
from invid_drivers.cia402.stated.declared import refusal
from invid_drivers.cia402.stated.scales import WHOLE, Scaling, read_factors
from invid_drivers.cia402.states import DriveState, OperationMode, is_energised, state_of

INVALID = 1 << 31
"""Bit of a COB-ID that switches a PDO off."""
NO_RTR = 1 << 30
"""Bit of a COB-ID: a TPDO is not sent on request. Drives that answer no such requests insist on it."""
PROFILE = 402
PROFILES = {
    401: "an I/O module (profile 401)",
    404: "a measuring device (profile 404)",
    405: "a programmable controller (profile 405)",
    406: "an encoder (profile 406)",
    408: "a hydraulic drive (profile 408)",
    410: "an inclinometer (profile 410)",
}
"""0x1000, low word."""
SERVO = 0x02
OTHER_KINDS = {0x01: "a frequency converter", 0x04: "a stepper drive", 0x08: "an I/O device"}
"""0x1000, bits 16 to 23."""
SYNCHRONOUS = 1
"""Transmission type: with every SYNC."""


class ModeSet(Enum):
    """What came of a mode that was set without power."""

    SHOWN = "0x6061 shows it"
    TAKEN = "taken, and 0x6061 shows none yet: some drives show it when they are enabled"
    LATER = "not taken in this state: some drives take it from switched on"


NOT_KNOWN = frozenset({0x06090030, 0x06090031, 0x06090032})
"""SDO aborts of a drive that does not have the mode that it is asked for."""
BLANK_S = 1.0
"""So long a drive may show no mode at all before it is believed that it does so until it is enabled: slow
ones take 0.8 s."""


@dataclass(frozen=True)
class DriveReport:
    """What a drive can do, asked of the drive."""

    axis: str
    node_id: int
    vendor_id: int
    product_code: int
    serial: int
    scaling: Scaling
    torque_mode: OperationMode
    can_hold: bool
    by_offset: bool
    """Shaken by its torque offset in cyclic synchronous position: the loop stays closed in the drive."""
    lacks: tuple[str, ...]
    warnings: tuple[str, ...]
    limits: EffectiveLimits
    stopping: StoppingFacts

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "axis": self.axis,
            "node_id": self.node_id,
            "vendor_id": self.vendor_id,
            "product_code": self.product_code,
            "serial": self.serial,
            "rated_torque": self.scaling.rated_torque,
            "position_per_count": self.scaling.position_per_count,
            "torque_mode": self.torque_mode.name.lower(),
            "can_hold": self.can_hold,
            "by_offset": self.by_offset,
            "lacks": list(self.lacks),
            "warnings": list(self.warnings),
            "limits": asdict(self.limits),
        }


class Drive(Access):
    """One drive of the cell."""

    def __init__(self, link: Link, config: AxisConfig, journal: Journal, cell: CellConfig) -> None:
        super().__init__(link, config, journal, linear=cell.linear)
        self.protection = Protection(self, cell.safety.heartbeat_s)
        self.left_alone = False
        """What it shows may not be believed: nothing is written, not even what stands there."""
        self.axes_of_node = tuple(a.axis_of_node for a in cell.axes if a.node_id == config.node_id)
        """Axes of its node in this cell."""
        self._cycle_s = cell.bus.cycle_s
        self._most_skipped = max(cell.safety.missed_tpdos, cell.safety.overrun_cycles)
        self.by_offset = False
        """Whether it is shaken by its torque offset (0x60B2); known from ``check`` on."""
        self._timer: int | None = None
        """0x1400:5 that goes with the map, from ``protect`` on."""

    def _timer_ms(self) -> int | None:
        """0x1400:5 as it is written; DriveError where the cycle cannot keep it."""
        timer = event_timer(self, self._cycle_s, self._most_skipped)
        if timer is not None and timer < 2 * self._cycle_s * 1000:
            raise DriveError(
                sentence(
                    "{who}: 0x1400:5 of the drive stops it after {ms} ms without its RPDO, and is "
                    "not loosened; set bus.cycle_s to {cycle_s:g} at most, or 0x1400:5 with the "
                    "drive's tool",
                    who=self.who,
                    ms=timer,
                    cycle_s=timer / 2000,
                ),
                axis=self.name,
            )
        return timer

    # --- preflight -----------------------------------------------------------------------------
    def check(self, said: Sequence[str] = ()) -> DriveReport:
        """Ask the drive what it can do; DriveError in plain words where it cannot do the job.

        ``said``: what is known of it already, for the report's warnings.
        """
        warnings: list[str] = [*said, *self.eds_warnings]
        self.refuse_declared()
        self._require_servo(self.read(od.DEVICE_TYPE), warnings)
        self.serial = self.find(od.SERIAL_NUMBER) or 0
        if self.find(od.pdo_communication("RPDO", 1, 1)) is None:
            number = self.of_node.number  # not where CiA 301 foresees it: with those of the first axis
            self.of_node = NodeAxis(number, number)
        self._compare_identity(warnings)
        self.by_offset = self._takes_offset()
        self._require_objects()
        mode, can_hold = self._modes(warnings)
        factors = read_factors(self.find, self.config, linear=self.linear, vendor=self.vendor)
        scaling = factors.scaling
        warnings += factors.notes
        lacks = self._lacks(can_hold)
        state = state_of(self.read(od.STATUSWORD))
        if state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            code = self.find(od.ERROR_CODE) or 0
            raise DriveError(
                sentence(
                    "{who}: in fault (error 0x{code:04X}); find the cause, then reset it at the drive "
                    "or with its tool: this service never resets a fault by itself",
                    who=self.who,
                    code=code,
                ),
                axis=self.name,
            )
        limits = self.protection.limits(scaling, warnings)
        if (
            not is_energised(state) and not self.left_alone
        ):  # under power nothing is written, not even what stands there already
            lacks += self.protection.unwritable(scaling, limits)
        return DriveReport(
            axis=self.name,
            node_id=self.node_id,
            vendor_id=self.find(od.VENDOR_ID) or 0,
            product_code=self.find(od.PRODUCT_CODE) or 0,
            serial=self.serial,
            scaling=scaling,
            torque_mode=mode,
            can_hold=can_hold,
            by_offset=self.by_offset,
            lacks=tuple(lacks),
            warnings=tuple(warnings),
            limits=limits,
            stopping=self.protection.stopping(scaling, limits, self._timer_ms()),
        )

    def _require_servo(self, device: int, warnings: list[str]) -> None:
        """Refuse what is no servo drive by 0x1000: profile in the low word, kinds in bits 16 to 23."""
        said = sentence("{who}: 0x1000 is 0x{device:08X}", who=self.who, device=device)
        profile, kinds = device & 0xFFFF, device >> 16 & 0xFF
        if device == 0:  # no profile by CiA 301; what a drive must have is asked for one by one
            warnings.append(f"{self.who}: 0x1000 is 0: it does not say that it is a drive")
        elif profile != PROFILE:
            name = PROFILES.get(profile, f"a device of profile {profile}")
            raise DriveError(
                sentence(
                    "{said}: {name}, no CiA 402 drive; is node_id that of this axis's drive?",
                    said=said,
                    name=name,
                ),
                axis=self.name,
            )
        elif kinds == 0:
            warnings.append(f"{said}: it does not say what kind of drive it is")
        elif not kinds & SERVO:
            names = [name for bit, name in OTHER_KINDS.items() if kinds & bit] or ["no servo drive"]
            reason = self.config.overrides.get("0x1000")
            if reason is None:
                raise DriveError(
                    sentence(
                        "{said}: {names}, no servo drive; is node_id that of this axis's drive? If it is, "
                        'and it controls torque all the same, say why: overrides: {{"0x1000": "reason"}}',
                        said=said,
                        names=" and ".join(names),
                    ),
                    axis=self.name,
                )
            warnings.append(f"{said}: {' and '.join(names)}; used all the same, as overrides says ({reason})")

    def refuse_declared(self) -> None:
        """DriveError where the EDS says that the drive cannot do the job; asks nothing."""
        by_offset = self.vendor.takes_offset
        why = None if self.declared is None else refusal(self.declared, by_offset=by_offset)
        if why is not None and self.declared is not None:
            raise DriveError(
                sentence(
                    "{who}: by its EDS {name} the drive {why}; this drive cannot be shaken. Log its "
                    "motion with another tool and use `invid import`; if the file is not this drive's, "
                    "leave eds out and the drive itself is asked",
                    who=self.who,
                    name=self.declared.path.name,
                    why=why,
                ),
                axis=self.name,
            )

    def _compare_identity(self, warnings: list[str]) -> None:
        """Drop an EDS that is of another vendor or product than the drive says, with a warning."""
        declared = self.declared
        if declared is None:
            return
        for what, said in ((od.VENDOR_ID, declared.vendor_id), (od.PRODUCT_CODE, declared.product_code)):
            found = self.find(what)
            if said and found is not None and found != said:
                warnings.append(
                    f"{self.who}: EDS {declared.path.name} is of {what.name} 0x{said:X}, the drive says "
                    f"0x{found:X}; the drive itself is asked for everything"
                )
                self.declared = None
                return

    def _takes_offset(self) -> bool:
        """Whether it is shaken by its torque offset in cyclic synchronous position: for want of a torque
        mode, or since its loops are to stay closed; DriveError where they are to and cannot."""
        modes = self.find(od.SUPPORTED_MODES)
        if self.config.in_closed_loop:
            follows = modes is None or modes & OperationMode.CYCLIC_POSITION.supported_bit
            if follows and self.find(od.TORQUE_OFFSET) is not None:
                return True
            raise DriveError(
                sentence(
                    "{who}: its loops cannot be shaken while they are closed: that takes cyclic "
                    "synchronous position and a torque offset (0x60B2)",
                    who=self.who,
                ),
                way_out=sentence("compare moves before and after with the drive's own tool"),
                axis=self.name,
            )
        if modes is None or not modes & OperationMode.CYCLIC_POSITION.supported_bit:
            return False
        torque = OperationMode.CYCLIC_TORQUE.supported_bit | OperationMode.PROFILE_TORQUE.supported_bit
        takes = not modes & torque and self.vendor.takes_offset
        return takes and self.find(od.TORQUE_OFFSET) is not None

    def _require_objects(self) -> None:
        command = od.TORQUE_OFFSET if self.by_offset else od.TARGET_TORQUE
        for what, why in (
            (command, sentence("torque cannot be commanded")),
            (od.TORQUE, sentence("torque cannot be measured")),
            (od.POSITION, sentence("position cannot be measured")),
        ):
            if self.find(what) is None:
                raise DriveError(
                    sentence(
                        "{who}: the drive has no {address} ({what}): {why}; this drive cannot be shaken. "
                        "Log its motion with another tool and use `invid import`",
                        who=self.who,
                        address=what.address,
                        what=what.name,
                        why=why,
                    ),
                    axis=self.name,
                )

    def _modes(self, warnings: list[str]) -> tuple[OperationMode, bool]:
        supported = self.find(od.SUPPORTED_MODES)
        if supported is None:
            supported = self._tried_modes()
            warnings.append(f"{self.who}: 0x6502 is missing; its modes are those that it takes in 0x6060")
        can_hold = bool(supported & OperationMode.CYCLIC_POSITION.supported_bit)
        if self.by_offset:
            if not self.config.in_closed_loop:
                warnings.append(
                    f"{self.who}: no torque mode; it is shaken by its torque offset (0x60B2) in cyclic "
                    "synchronous position: its own loop stays closed, and stiffens the axis below its "
                    "bandwidth"
                )
            return OperationMode.CYCLIC_POSITION, True
        for mode in (OperationMode.CYCLIC_TORQUE, OperationMode.PROFILE_TORQUE):
            if supported & mode.supported_bit:
                if mode is OperationMode.PROFILE_TORQUE:
                    warnings.append(
                        f"{self.who}: only profile torque; its torque slope (0x6087) may distort the "
                        "excitation"
                    )
                return mode, can_hold
        raise DriveError(
            sentence(
                "{who}: the drive has no torque mode (0x6502 is 0x{supported:08X}, bits 9 and 3 "
                "are clear); it cannot be shaken. Choose a drive or firmware with cyclic "
                "synchronous torque, or with cyclic synchronous position and a torque offset "
                "(0x60B2), or record with its own tool and use `invid import`",
                who=self.who,
                supported=supported,
            ),
            axis=self.name,
        )

    def _tried_modes(self) -> int:
        """Modes as in 0x6502, by setting each without power: what the drive does not refuse counts."""
        state = state_of(self.read(od.STATUSWORD))
        found = self.find(od.MODE)
        supported = 0
        for mode in OperationMode:
            known = True
            if not is_energised(state) and not self.left_alone and found is not None:
                try:
                    self.command(od.MODE, int(mode))
                except WriteRefused as error:
                    known = error.abort not in NOT_KNOWN
            supported |= mode.supported_bit if known else 0
        if not is_energised(state) and not self.left_alone and found is not None:
            with contextlib.suppress(WriteRefused):
                self.command(od.MODE, found)
        return supported

    def _lacks(self, can_hold: bool) -> list[str]:
        lacks = []
        if self.find(od.CONSUMER_HEARTBEAT) is None:
            if not self.config.allow_missing_heartbeat:
                raise DriveError(
                    sentence(
                        "{who}: the drive cannot watch the master's heartbeat (0x1016 is missing): if this "
                        "computer dies, the axis keeps its last torque. Where another device stops it "
                        "then, set allow_missing_heartbeat: true for the axis",
                        who=self.who,
                    ),
                    axis=self.name,
                )
            lacks.append("0x1016 consumer heartbeat: the drive does not notice when the master dies")
        else:
            lacks += self.protection.heartbeat_lacks()
        for what, loss in (
            (od.PRODUCER_HEARTBEAT, "the master only notices by missing TPDOs when the drive dies"),
            (od.ABORT_CONNECTION, "what the drive does without its master is its own default"),
            (od.QUICK_STOP_OPTION, "how the drive stops quickly is its own default"),
            (od.POSITION_LIMIT_LOW, "only the master watches the position window"),
            (od.FOLLOWING_WINDOW, "only the master watches a held axis"),
            (od.MAX_VELOCITY, "only the master watches the velocity"),
        ):
            if self.find(what) is None:
                lacks.append(f"{what.address} {what.name}: {loss}")
        if self.find(od.MAX_TORQUE) is None:
            other = self.vendor.torque_limit
            if other is not None and self.find(other) is not None:
                lacks.append(
                    f"{od.MAX_TORQUE.address} max torque: {other.address} {other.name} is used instead"
                )
            else:
                lacks.append("0x6072 max torque: only the master limits the torque")
        if not can_hold:
            lacks.append("cyclic synchronous position: the drive cannot hold the axis by itself")
        return lacks

    def counts_of_circle(self) -> int:
        """Counts after which 0x6064 begins again, by 0x607B or of 32 bits."""
        low, high = self.find(od.RANGE_LOW), self.find(od.RANGE_HIGH)
        return WHOLE if low is None or high is None or low >= high else high - low + 1

    # --- configuration -------------------------------------------------------------------------
    def restore(self) -> tuple[str, ...]:
        """Undo what was written, where it still stands; what was left and why, in words."""
        return restore(self, self.axes_of_node)

    def protect(self, report: DriveReport) -> None:
        """Give the drive its own protection before it is enabled, never less than it has."""
        self.protection.write(report.scaling, report.limits)
        self._timer = self._timer_ms()
        added = (od.POSITION_OFFSET,) if self.by_offset else (od.POSITION_OFFSET, od.TORQUE_OFFSET)
        for what in added:
            self._clear(what, "it adds to every command")
        self._clear(od.SYNC_COUNTER, "SYNC of this master has no counter")

    def _clear(self, what: Object, why: str) -> None:
        """Set an object to 0; DriveError where it stands otherwise and cannot be written."""
        found = self.find(what)
        if not found:
            return
        try:
            self.write(what, 0)
        except WriteRefused as error:
            raise DriveError(
                sentence(
                    "{who}: {address} {what} is {found}: {why}, and it cannot be set to 0 ({error})",
                    who=self.who,
                    address=what.address,
                    what=what.name,
                    found=found,
                    why=why,
                    error=error,
                ),
                way_out=sentence("set it to 0 with the drive's tool"),
                axis=self.name,
            ) from None

    def map_pdos(self) -> None:
        """RPDO 1: controlword, target torque. TPDO 1: position, torque, statusword. Both with SYNC.

        A drive that is shaken by its torque offset has that in place of the target torque.
        """
        targets = od.OFFSET_MAP if self.by_offset else od.RPDO_MAP
        place = self.of_node
        for kind, wanted in (("RPDO", targets), ("TPDO", od.TPDO_MAP)):
            cob, first = place.cob_id(kind, self.node_id), place.number == min(self.axes_of_node)
            for number in range(2, self._pdos(kind) + 1) if first else ():
                other = od.pdo_communication(kind, number, 1)
                value = self.find(other)
                if value is not None and not value & INVALID:
                    self.write(other, value | INVALID)
            try:
                present = self.read(od.pdo_communication(kind, 1, 1))
                self.write(od.pdo_communication(kind, 1, 1), present | INVALID)
                self.write(od.pdo_mapping(kind, 1, 0), 0)
                for sub, what in enumerate(map(place.at, wanted), start=1):
                    self.write(od.pdo_mapping(kind, 1, sub), what.mapping)
                self.write(od.pdo_mapping(kind, 1, 0), len(wanted))
                self.write(od.pdo_communication(kind, 1, 2), SYNCHRONOUS)
                if kind == "RPDO":
                    self._write_timer()
                else:
                    self._clear(od.INHIBIT_TIME, "TPDO 1 would not follow every SYNC")
                self.write(od.pdo_communication(kind, 1, 1), cob | present & NO_RTR)
            except (ReadRefused, WriteRefused) as error:
                names = ", ".join(f"{o.address} {o.name}" for o in wanted)
                raise DriveError(
                    sentence(
                        "{who}: {kind} 1 cannot be mapped to {names}: {error}; this drive cannot be run in "
                        "the cycle",
                        who=self.who,
                        kind=kind,
                        names=names,
                        error=error,
                    ),
                    axis=self.name,
                ) from None

    def _write_timer(self) -> None:
        """Write 0x1400:5, by which missing RPDOs stop the drive; one that refuses has its heartbeat watch."""
        if self._timer is None:
            return
        try:
            self.write(od.RPDO_EVENT_TIMER, self._timer)
        except WriteRefused:
            if self.vendor.rpdo_event_timer.certain:
                raise

    def _pdos(self, kind: str) -> int:
        """How many PDOs of a kind the EDS lists; at most the eight that are switched off one by one."""
        listed = self.declared
        return 8 if listed is None else min(8, listed.rpdos if kind == "RPDO" else listed.tpdos)

    def set_mode(self, mode: OperationMode, longest_s: float) -> ModeSet:
        """Write 0x6060 without power, wait until 0x6061 shows it, and return what came of it.

        ObjectError where it shows another one.
        """
        try:
            self.command(od.MODE, int(mode))
        except WriteRefused as error:
            if error.abort != NOT_NOW:
                raise
            return ModeSet.LATER
        clock = self.link.clock
        began = clock.now()
        while True:
            shown = self.read(od.MODE_DISPLAY)
            if shown == int(mode):
                return ModeSet.SHOWN
            if shown == 0 and clock.now() >= began + BLANK_S:
                return ModeSet.TAKEN
            if clock.now() >= began + (longest_s if shown > 0 else max(longest_s, BUSY_S)):
                said = f"mode {mode.name.lower()} was asked for, the drive shows mode {shown} (0x6061)"
                raise ObjectError.at(self.name, self.node_id, od.MODE_DISPLAY, said)
            self.link.wait(0.005)

    # --- on the way out ------------------------------------------------------------------------
    def quiet_state(self) -> DriveState | None:
        """The state by SDO; ``None`` where the drive does not say."""
        try:
            return state_of(self.read(od.STATUSWORD))
        except (BusError, SdoError):
            return None
