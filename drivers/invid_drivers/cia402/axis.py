"""One drive over SDO: can it do the job, its scalings, its protection, its PDO maps."""

from __future__ import annotations

import contextlib
import math
import struct
from dataclasses import dataclass
from typing import Any

from invid.config import AxisConfig
from invid.errors import BusError, DriveError
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.declared import declared_of, refusal
from invid_drivers.cia402.journal import Entry, Journal
from invid_drivers.cia402.link import (
    MASTER_ID,
    Link,
    SdoAbortedError,
    SdoCommunicationError,
    SdoError,
)
from invid_drivers.cia402.objects import Object
from invid_drivers.cia402.states import DriveState, OperationMode, state_of
from invid_drivers.cia402.units import Scaling, position_per_count
from invid_drivers.cia402.vendors import VENDORS, vendor

INVALID = 1 << 31
"""Bit of a COB-ID that switches a PDO off."""
DRIVE_MARGIN = 1.25
"""The drive's own windows are a quarter wider than the master's: the master, who sees all axes and can
tell a runaway, acts first, and the drive where the master does not."""
MOST_OF_RATED, MUCH_OF_RATED = 32.767, 5.0
"""A torque limit beyond the first multiple of the rated torque cannot even be commanded (0x6071 is INTEGER16
in thousandths). Beyond the second it is asked whether it is meant: servo motors peak at three to five times
(a guess at what is usual)."""
PROTECTION = (
    od.CONSUMER_HEARTBEAT, od.PRODUCER_HEARTBEAT, od.ABORT_CONNECTION, od.QUICK_STOP_OPTION, od.MAX_TORQUE,
    od.POSITION_LIMIT_LOW, od.POSITION_LIMIT_HIGH, od.MAX_VELOCITY, od.FOLLOWING_WINDOW, od.FOLLOWING_TIME,
)  # fmt: skip
"""What keeps an axis from doing harm by itself: asked for whatever an EDS says."""
SYNCHRONOUS = 1
"""Transmission type: with every SYNC."""


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
    lacks: tuple[str, ...]
    warnings: tuple[str, ...]

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
            "lacks": list(self.lacks),
            "warnings": list(self.warnings),
        }


class Drive:
    """One drive of the cell; all access goes through the link."""

    def __init__(self, link: Link, config: AxisConfig, journal: Journal, *, linear: bool) -> None:
        self.config = config
        self.name, self.node_id = config.name, config.node_id
        self._link, self._journal, self._linear = link, journal, linear
        self._serial = 0
        self._held = False
        row = vendor(config.vendor)
        if row is None:
            raise DriveError(
                f"axis {self.name}: vendor {config.vendor!r} is not in the table; known are "
                f"{', '.join(sorted(VENDORS))} (generic asks the drive for everything)"
            )
        self._vendor = row
        self._declared, self._eds_warnings = declared_of(self.name, config.eds, config.node_id)
        link.add_peer(self.node_id, self.name)

    # --- SDO -----------------------------------------------------------------------------------
    def read(self, what: Object) -> int:
        """Value of an object; DriveError where there is no answer or the drive refuses."""
        return what.unpack(self._upload(what))

    def find(self, what: Object) -> int | None:
        """Value of an object; ``None`` where the drive lacks it.

        What the EDS does not list is not asked for, but for the drive's own protection: there firmware newer
        than the file may have more.
        """
        declared = self._declared
        if declared is not None and what not in PROTECTION and declared.find(what.index, what.sub) is None:
            return None
        try:
            return what.unpack(self._link.sdo(self.node_id).upload(what.index, what.sub))
        except SdoAbortedError:
            return None
        except SdoError as error:
            raise self._silent(what, error) from None

    def write(self, what: Object, value: int) -> None:
        """Write, journal first; DriveError where the drive refuses."""
        data = what.pack(value)
        before = self._before(what)
        if before == data:
            return
        if before is not None:
            self._journal.add(Entry(self.node_id, self._serial, what.index, what.sub, before.hex()))
        self._download(what, data)

    def _before(self, what: Object) -> bytes | None:
        try:
            return bytes(self._link.sdo(self.node_id).upload(what.index, what.sub))[: what.size]
        except SdoAbortedError:
            return None
        except SdoError as error:
            raise self._silent(what, error) from None

    def _upload(self, what: Object) -> bytes:
        try:
            return bytes(self._link.sdo(self.node_id).upload(what.index, what.sub))
        except SdoAbortedError as error:
            raise DriveError(
                f"axis {self.name} (node {self.node_id}): {what.address} {what.name} cannot be read: "
                f"{_abort(error)}"
            ) from None
        except SdoError as error:
            raise self._silent(what, error) from None

    def _download(self, what: Object, data: bytes) -> None:
        try:
            self._link.sdo(self.node_id).download(what.index, what.sub, data)
        except SdoAbortedError as error:
            raise DriveError(
                f"axis {self.name} (node {self.node_id}): {what.address} {what.name} cannot be written "
                f"(0x{data[::-1].hex()}): {_abort(error)}"
            ) from None
        except SdoError as error:
            raise self._silent(what, error) from None

    def command(self, what: Object, value: int) -> None:
        """Write an object that is part of running (controlword, mode, targets): not journalled."""
        self._download(what, what.pack(value))

    def _silent(self, what: Object, error: Exception) -> DriveError:
        if isinstance(error, SdoCommunicationError):
            return DriveError(
                f"axis {self.name}: node {self.node_id} does not answer ({what.address} {what.name}); check "
                "that the drive has power, node_id and bit rate, and the cable"
            )
        return DriveError(f"axis {self.name} (node {self.node_id}): {what.address} {what.name}: {error}")

    # --- preflight -----------------------------------------------------------------------------
    def check(self) -> DriveReport:
        """Capabilities of the drive; DriveError in plain words where it cannot do the job."""
        who = f"axis {self.name} (node {self.node_id})"
        warnings: list[str] = list(self._eds_warnings)
        self._refuse_declared(who)
        self.read(od.DEVICE_TYPE)
        self._serial = self.find(od.SERIAL_NUMBER) or 0
        self._compare_identity(who, warnings)
        self._require_objects(who)
        mode, can_hold = self._modes(who, warnings)
        scaling = Scaling(self._position(who), self._rated(who, warnings), self.config.direction)
        self._compare_limit(who, scaling.rated_torque, warnings)
        lacks = self._lacks(can_hold)
        state = state_of(self.read(od.STATUSWORD))
        if state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            code = self.find(od.ERROR_CODE) or 0
            raise DriveError(
                f"{who}: in fault (error 0x{code:04X}); find the cause, then reset it at the drive or "
                "with its "
                "tool: this service never resets a fault by itself"
            )
        return DriveReport(
            axis=self.name,
            node_id=self.node_id,
            vendor_id=self.find(od.VENDOR_ID) or 0,
            product_code=self.find(od.PRODUCT_CODE) or 0,
            serial=self._serial,
            scaling=scaling,
            torque_mode=mode,
            can_hold=can_hold,
            lacks=tuple(lacks),
            warnings=tuple(warnings),
        )

    def _refuse_declared(self, who: str) -> None:
        why = None if self._declared is None else refusal(self._declared)
        if why is not None and self._declared is not None:
            raise DriveError(
                f"{who}: by its EDS {self._declared.path.name} the drive {why}; this drive cannot be shaken. "
                "Log its motion with another tool and use `invid import`; if the file is not this drive's, "
                "leave eds out and the drive itself is asked"
            )

    def _compare_identity(self, who: str, warnings: list[str]) -> None:
        """An EDS of another device is not believed."""
        declared = self._declared
        if declared is None:
            return
        for what, said in ((od.VENDOR_ID, declared.vendor_id), (od.PRODUCT_CODE, declared.product_code)):
            found = self.find(what)
            if said and found is not None and found != said:
                warnings.append(
                    f"{who}: EDS {declared.path.name} is of {what.name} 0x{said:X}, the drive says "
                    f"0x{found:X}; the drive itself is asked for everything"
                )
                self._declared = None
                return

    def _require_objects(self, who: str) -> None:
        for what, why in (
            (od.TARGET_TORQUE, "torque cannot be commanded"),
            (od.TORQUE, "torque cannot be measured"),
            (od.POSITION, "position cannot be measured"),
        ):
            if self.find(what) is None:
                raise DriveError(
                    f"{who}: the drive has no {what.address} ({what.name}): {why}; this drive cannot be "
                    "shaken. "
                    "Log its motion with another tool and use `invid import`"
                )

    def _modes(self, who: str, warnings: list[str]) -> tuple[OperationMode, bool]:
        supported = self.find(od.SUPPORTED_MODES)
        if supported is None:
            warnings.append(f"{who}: 0x6502 is missing; cyclic synchronous torque and position are assumed")
            return OperationMode.CYCLIC_TORQUE, True
        can_hold = bool(supported & OperationMode.CYCLIC_POSITION.supported_bit)
        for mode in (OperationMode.CYCLIC_TORQUE, OperationMode.PROFILE_TORQUE):
            if supported & mode.supported_bit:
                if mode is OperationMode.PROFILE_TORQUE:
                    warnings.append(
                        f"{who}: only profile torque; its torque slope (0x6087) may distort the excitation"
                    )
                return mode, can_hold
        raise DriveError(
            f"{who}: the drive has no torque mode (0x6502 is 0x{supported:08X}, bits 9 and 3 are clear); "
            "it cannot be shaken. Choose a drive or firmware with cyclic synchronous torque"
        )

    def _rated(self, who: str, warnings: list[str]) -> float:
        from_drive = (self.find(od.RATED_TORQUE) or 0) / 1000.0
        configured = self.config.rated_torque
        if from_drive <= 0:
            if configured is None:
                raise DriveError(
                    f"{who}: 0x6076 motor rated torque is missing or 0, so torque has no scale; give "
                    f"rated_{'force_N' if self._linear else 'torque_Nm'} in the config. "
                    f"{self._vendor.advice}".rstrip()
                )
            return configured
        if configured is not None and abs(configured - from_drive) > 0.05 * from_drive:
            warnings.append(
                f"{who}: the drive says rated torque {from_drive:g}, the config {configured:g}; the "
                "drive's counts"
            )
        return from_drive

    def _compare_limit(self, who: str, rated: float, warnings: list[str]) -> None:
        """A torque limit in another unit, or of another motor, would be believed by nobody who reads it."""
        limit = self.config.limits.torque
        key, unit = ("force_N", "N") if self._linear else ("torque_Nm", "N·m")
        said = f"{who}: limits.{key} is {limit:g}, {limit / rated:.3g} times the rated {rated:g} {unit}"
        if limit > MOST_OF_RATED * rated:
            raise DriveError(
                f"{said}; 0x6071 cannot command more than {MOST_OF_RATED:g} times. Correct the limit, its "
                "unit or the rated value"
            )
        if limit > MUCH_OF_RATED * rated:
            warnings.append(f"{said}: is that limit meant?")

    def _position(self, who: str) -> float:
        if self.config.position_per_count is not None:
            return self.config.position_per_count
        increments = self.find(od.ENCODER_INCREMENTS) or 0
        turns = (self.find(od.ENCODER_REVOLUTIONS) or 0) if increments else 0
        feed = self.find(od.FEED) or 0
        feed_turns = (self.find(od.FEED_REVOLUTIONS) or 0) if feed else 0
        if feed_turns:
            # 0x6092 is per shaft revolution; the motor turns 0x6091 times as often
            motor, shaft = self.find(od.GEAR_MOTOR) or 1, self.find(od.GEAR_SHAFT) or 1
            feed, feed_turns = feed * shaft, feed_turns * motor
        found = position_per_count(
            increments, turns, linear=self._linear, feed=feed, feed_revolutions=feed_turns
        )
        if found is None:
            raise DriveError(
                f"{who}: 0x608F encoder resolution is missing or 0, so position has no scale; give "
                f"position_{'m' if self._linear else 'rad'}_per_count in the config. "
                f"{self._vendor.advice}".rstrip()
            )
        return found

    def _lacks(self, can_hold: bool) -> list[str]:
        who = f"axis {self.name} (node {self.node_id})"
        lacks = []
        if self.find(od.CONSUMER_HEARTBEAT) is None:
            if not self.config.allow_missing_heartbeat:
                raise DriveError(
                    f"{who}: the drive cannot watch the master's heartbeat (0x1016 is missing): if this "
                    "computer "
                    "dies, the axis keeps its last torque. Where another device stops it then, set "
                    "allow_missing_heartbeat: true for the axis"
                )
            lacks.append("0x1016 consumer heartbeat: the drive does not notice when the master dies")
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
            other = self._vendor.torque_limit
            if other is not None and self.find(other) is not None:
                lacks.append(
                    f"{od.MAX_TORQUE.address} max torque: {other.address} {other.name} is used instead"
                )
            else:
                lacks.append("0x6072 max torque: only the master limits the torque")
        if not can_hold:
            lacks.append("cyclic synchronous position: the drive cannot hold the axis by itself")
            if self.config.hold.mode == "drive" and self.config.gravity_loaded:
                raise DriveError(
                    f"{who}: gravity-loaded, but the drive cannot hold its place by itself (no cyclic "
                    "synchronous "
                    "position in 0x6502); it would fall when stopped. Use a drive that can, or unload "
                    "the axis"
                )
        return lacks

    # --- configuration -------------------------------------------------------------------------
    def restore(self) -> int:
        """Undo every journalled write; number of objects restored. The drive must not be operational.

        Writes into another drive that had this node id before are forgotten: after an exchange, the values of
        the old drive are not this one's.
        """
        entries = self._journal.of_node(self.node_id)
        serial = self.find(od.SERIAL_NUMBER) if entries else None
        if serial:
            entries = tuple(e for e in entries if e.serial in (0, serial))
        failed = None
        for e in entries:
            try:
                self._link.sdo(self.node_id).download(e.index, e.sub, bytes.fromhex(e.before))
            except SdoAbortedError as error:
                # Refused now, though it could be written before: say so, restore the rest.
                failed = failed or f"0x{e.index:04X}:{e.sub} ({_abort(error)})"
            except SdoError as error:
                raise self._silent(Object(e.index, e.sub, "B", "while restoring"), error) from None
        self._journal.forget(self.node_id)
        if failed:
            raise DriveError(f"axis {self.name} (node {self.node_id}): {failed} could not be restored")
        return len(entries)

    def protect(self, report: DriveReport, heartbeat_s: float) -> None:
        """Give the drive its own protection before it is enabled; what it lacks is in the report."""
        scaling, limits = report.scaling, self.config.limits
        beat_ms = max(1, round(heartbeat_s * 1000))
        # Three periods: one lost frame and one late one do not stop the cell.
        self._try(od.CONSUMER_HEARTBEAT, MASTER_ID << 16 | 3 * beat_ms)
        self._try(od.PRODUCER_HEARTBEAT, beat_ms)
        self._try(od.ABORT_CONNECTION, 3)  # quick stop
        stays = self.config.gravity_loaded and self.config.brake == "none"
        self._try(od.QUICK_STOP_OPTION, 6 if stays else 2)  # stop on the ramp, then stay or switch off
        permille = math.ceil(limits.torque / scaling.rated_torque * 1000)
        highest = None if self._declared is None else self._declared.find(od.MAX_TORQUE.index, 0)
        if highest is not None and highest.high is not None:
            permille = min(permille, highest.high)  # the drive takes no more, and allows no more
        if not self._try(od.MAX_TORQUE, permille):
            self._limit_current(permille)
        here = self.read(od.POSITION)
        window = max(1, math.ceil(DRIVE_MARGIN * limits.position / scaling.position_per_count))
        self._try(od.POSITION_LIMIT_LOW, here - window)
        self._try(od.POSITION_LIMIT_HIGH, here + window)
        speed = DRIVE_MARGIN * limits.velocity / scaling.position_per_count
        if self._vendor.velocity_in_rpm:
            speed = DRIVE_MARGIN * limits.velocity * 60 / (1.0 if self._linear else 2 * math.pi)
        self._try(od.MAX_VELOCITY, max(1, math.ceil(speed)))
        self._try(od.FOLLOWING_WINDOW, window)
        self._try(od.FOLLOWING_TIME, 10)

    def _try(self, what: Object, value: int) -> bool:
        if self.find(what) is None:
            return False
        self.write(what, value)
        return True

    def _limit_current(self, permille: int) -> None:
        limit, nominal = self._vendor.torque_limit, self._vendor.nominal_current
        if limit is None or nominal is None:
            return
        present, rated = self.find(limit), self.find(nominal)
        if present is not None and rated:
            self.write(limit, min(present, math.ceil(rated * permille / 1000)))

    def map_pdos(self) -> None:
        """RPDO 1: controlword, target torque. TPDO 1: position, torque, statusword. Both with SYNC."""
        who = f"axis {self.name} (node {self.node_id})"
        for kind, communication, mapping, wanted, cob in (
            ("RPDO", od.rpdo_communication, od.rpdo_mapping, od.RPDO_MAP, 0x200 + self.node_id),
            ("TPDO", od.tpdo_communication, od.tpdo_mapping, od.TPDO_MAP, 0x180 + self.node_id),
        ):
            for number in range(2, self._pdos(kind) + 1):
                other = communication(number, 1)
                value = self.find(other)
                if value is not None and not value & INVALID:
                    self.write(other, value | INVALID)
            try:
                present = self.read(communication(1, 1))
                self.write(communication(1, 1), present | INVALID)
                self.write(mapping(1, 0), 0)
                for sub, what in enumerate(wanted, start=1):
                    self.write(mapping(1, sub), what.mapping)
                self.write(mapping(1, 0), len(wanted))
                self.write(communication(1, 2), SYNCHRONOUS)
                self.write(communication(1, 1), cob)
            except DriveError as error:
                if "does not answer" in str(error):
                    raise
                names = ", ".join(f"{o.address} {o.name}" for o in wanted)
                raise DriveError(
                    f"{who}: {kind} 1 cannot be mapped to {names}: {error}; this drive cannot be run in "
                    "the cycle"
                ) from None

    def _pdos(self, kind: str) -> int:
        """How many PDOs of a kind the EDS lists; at most the eight that are switched off one by one."""
        declared = self._declared
        if declared is None:
            return 8
        return min(8, declared.rpdos if kind == "RPDO" else declared.tpdos)

    def set_mode(self, mode: OperationMode, clock_wait: float = 0.5) -> None:
        """0x6060, and wait until 0x6061 shows it."""
        self.command(od.MODE, int(mode))
        clock = self._link.clock
        end = clock.now() + clock_wait
        while True:
            shown = self.read(od.MODE_DISPLAY)
            if shown == int(mode):
                return
            if clock.now() >= end:
                raise DriveError(
                    f"axis {self.name} (node {self.node_id}): mode {mode.name.lower()} was asked for, "
                    "the drive shows "
                    f"mode {shown} (0x6061)"
                )
            self._link.wait(0.005)

    # --- on the way out ------------------------------------------------------------------------
    def quiet_command(self, what: Object, value: int) -> None:
        """A command that tries."""
        with contextlib.suppress(BusError, SdoError):
            self._download(what, what.pack(value))

    def quiet_state(self) -> DriveState | None:
        """The state by SDO; ``None`` where the drive does not say."""
        try:
            return state_of(self.read(od.STATUSWORD))
        except (BusError, SdoError):
            return None

    def shout(self, what: Object, value: int) -> None:
        """A command to a drive that is not heard: sent once, no answer awaited."""
        data = what.pack(value)
        head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, what.index, what.sub)
        self._link.send(0x600 + self.node_id, (head + data).ljust(8, b"\0"))


_ABORTS = {
    0x06020000: "the object does not exist",
    0x06090011: "the subindex does not exist",
    0x06010002: "it is read-only",
    0x06010001: "it is write-only",
    0x06040041: "it cannot be mapped into a PDO",
    0x06040042: "the PDO would be too long",
    0x06090030: "the value is out of range",
    0x06090031: "the value is too high",
    0x06090032: "the value is too low",
    0x08000022: "not in the drive's present state",
}


def _abort(error: SdoAbortedError) -> str:
    code = int(error.code)
    return f"{_ABORTS.get(code, 'refused')} (SDO abort 0x{code:08X})"
