"""A drive's own protection: what limits stand in it, and writing the tighter ones before it is enabled."""

from __future__ import annotations

import math

from invid.errors import DriveError
from invid.planning.stopping_distance import StoppingFacts
from invid.wording.sentence import sentence
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.access import Access, WriteRefused
from invid_drivers.cia402.limits import (
    EffectiveLimits,
    Limit,
    counts_of_window,
    distance_to_edge,
    position_range,
    tighter,
    tighter_watch,
    tightest,
    watched,
)
from invid_drivers.cia402.link import MASTER_ID
from invid_drivers.cia402.objects import Object
from invid_drivers.cia402.standing.stopping import SWITCHES_OFF, Stop, stop_of, stopping_facts
from invid_drivers.cia402.stated.scales import Scaling, require_nominal_current, velocity_per_unit
from invid_drivers.eds import stated

DRIVE_MARGIN = 1.25
"""The drive's own windows are a quarter wider than the master's: the master, who sees all axes and can
tell a runaway, acts first, and the drive where the master does not."""
FOLLOWING_MS = 10
"""A following error outside its window is a fault after so long."""
STAYING = frozenset({5, 6, 7, 8})
"""0x605A: the drive stops and stays in quick stop active (CiA 402-2)."""
STAY, SWITCH_OFF = 6, 2
"""On the quick stop's ramp, then stay, or switch off."""
WATCHED = {
    0x6072: "the torque",
    0x607D: "the position window",
    0x607F: "the velocity",
    0x6065: "a held axis",
    0x6066: "a held axis",
}
"""What a limit of the drive is of, for messages."""


class Protection:
    """Reads and writes what one drive does by itself, whatever becomes of the master."""

    def __init__(self, drive: Access, heartbeat_s: float) -> None:
        self._drive = drive
        self._beat_ms = max(1, round(heartbeat_s * 1000))
        self._watch_ms = 3 * self._beat_ms
        """One lost heartbeat and one late one do not stop the cell."""
        self.quick_stop_option = SWITCH_OFF
        """What 0x605A is to be."""
        self.notes: tuple[str, ...] = ()
        """What turned out when it was written, in words."""

    def limits(self, scaling: Scaling, warnings: list[str]) -> EffectiveLimits:
        """The tightest of drive, config and EDS."""
        drive = self._drive
        limits = drive.config.limits
        length, torque = ("m", "N") if drive.linear else ("rad", "N·m")
        here = drive.read(od.POSITION)
        return EffectiveLimits(
            torque=tightest(
                Limit(limits.torque, f"limits.{'force_N' if drive.linear else 'torque_Nm'} of the config"),
                self._torque_limits(scaling, torque, warnings),
            ),
            position=tightest(
                Limit(limits.position, f"limits.position_window_{length} of the config"),
                self._position_limits(scaling, here),
            ),
            velocity=tightest(
                Limit(limits.velocity, f"limits.velocity_{length}_per_s of the config"),
                self._velocity_limits(scaling),
            ),
        )

    def _torque_limits(self, scaling: Scaling, unit: str, warnings: list[str]) -> list[Limit]:
        drive = self._drive
        rated, found = scaling.rated_torque, []
        for what in (od.MAX_TORQUE, od.POSITIVE_TORQUE_LIMIT, od.NEGATIVE_TORQUE_LIMIT):
            permille = drive.find(what)
            if permille == 0:
                self._require_shipped_zero(what, warnings)
            elif permille is not None:
                value = permille * rated / 1000
                found.append(Limit(value, f"{what.address} of the drive: {permille} ‰ of {rated:g} {unit}"))
        current = drive.find(od.MAX_CURRENT)
        if current:
            found.append(
                Limit(current * rated / 1000, f"0x6073 of the drive: {current} ‰ of its rated current")
            )
        vendors, nominal = drive.vendor.torque_limit, drive.vendor.nominal_current
        if vendors is not None and nominal is not None:
            present, whole = drive.find(vendors), drive.find(nominal)
            if present == 0:
                self._require_shipped_zero(vendors, warnings)
            elif present is not None and whole:
                warnings += require_nominal_current(drive, nominal, whole)
                found.append(
                    Limit(present / whole * rated, f"{vendors.address} of the drive: {present} of {whole} mA")
                )
        highest = None if drive.declared is None else drive.declared.find(od.MAX_TORQUE.index, 0)
        if highest is not None and isinstance(highest.max, int) and highest.max > 0:
            found.append(
                Limit(highest.max * rated / 1000, f"HighLimit of 0x6072 in the EDS: {highest.max} ‰")
            )
        return found

    def _require_shipped_zero(self, what: Object, warnings: list[str]) -> None:
        """Raise a limit of 0 only where nobody commissioned it and the config says so; else DriveError."""
        drive = self._drive
        declared = None if drive.declared is None else drive.declared.find(what.index, what.sub)
        shipped = what.address in drive.vendor.zero_as_shipped or (stated(declared) == 0)
        reason = drive.config.overrides.get(what.address)
        if shipped and reason is not None:
            warnings.append(
                f"{drive.who}: {what.address} {what.name} is 0, as the drive is shipped; it is raised while "
                f"measuring, as overrides says ({reason})"
            )
            return
        way_out = sentence("set it with the drive's tool: no limit is raised from here")
        if shipped:
            way_out = (
                "it is shipped so: where nobody set it on purpose, say so (overrides: "
                f'{{"{what.address}": "reason"}}), or set it with its tool'
            )
        raise DriveError(
            sentence(
                "{who}: {address} {what} is 0: the drive gives no torque; {way_out}",
                who=drive.who,
                address=what.address,
                what=what.name,
                way_out=way_out,
            ),
            axis=drive.name,
        )

    def _position_limits(self, scaling: Scaling, here: int) -> list[Limit]:
        drive = self._drive
        found = position_range(drive.find(od.POSITION_LIMIT_LOW), drive.find(od.POSITION_LIMIT_HIGH))
        if found is None:
            return []
        low, high = found
        left = distance_to_edge(here, low, high)
        if left <= 0:
            raise DriveError(
                sentence(
                    "{who}: it stands at {here}, outside of or at the edge of the drive's software "
                    "position limits (0x607D: {low} to {high}); move it inside, or correct 0x607D with "
                    "the drive's tool",
                    who=drive.who,
                    here=here,
                    low=low,
                    high=high,
                ),
                axis=drive.name,
            )
        value = left * scaling.position_per_count / DRIVE_MARGIN
        return [
            Limit(
                value,
                f"0x607D of the drive: {low} to {high}, the axis stands at {here}; a fifth is left to the "
                "drive, which would fault at its edge",
            )
        ]

    def _velocity_limits(self, scaling: Scaling) -> list[Limit]:
        drive = self._drive
        found = []
        profile = drive.find(od.MAX_VELOCITY)
        if profile:
            unit = "rpm" if drive.vendor.velocity_in_rpm else "counts/s"
            value = profile * velocity_per_unit(scaling.position_per_count, drive.vendor, linear=drive.linear)
            found.append(Limit(value, f"0x607F of the drive: {profile} {unit}"))
        motor = drive.find(od.MAX_MOTOR_SPEED)
        if motor and not drive.linear:
            found.append(Limit(motor * 2 * math.pi / 60, f"0x6080 of the drive: {motor} rpm"))
        return found

    def _wanted(self, scaling: Scaling, limits: EffectiveLimits) -> list[tuple[Object, int, int]]:
        """Limits of the drive as (object, found, wanted), in the order in which they may be written."""
        drive = self._drive
        permille = scaling.most_permille(limits.torque.value)
        window = counts_of_window(drive.config.limits.position, DRIVE_MARGIN, scaling.position_per_count)
        per_unit = velocity_per_unit(scaling.position_per_count, drive.vendor, linear=drive.linear)
        speed = math.ceil(DRIVE_MARGIN * drive.config.limits.velocity / per_unit)
        here = drive.read(od.POSITION)
        low, high = drive.find(od.POSITION_LIMIT_LOW), drive.find(od.POSITION_LIMIT_HIGH)
        edges = [
            (od.POSITION_LIMIT_LOW, low, here - window),
            (od.POSITION_LIMIT_HIGH, high, here + window),
        ]
        if high is not None and here - window > high:
            edges.reverse()  # the low edge would pass the high one
        wanted: list[tuple[Object, int | None, int]] = [
            *self._torque_protection(permille),
            *edges,
            (od.MAX_VELOCITY, drive.find(od.MAX_VELOCITY), max(1, speed)),
            (od.FOLLOWING_WINDOW, drive.find(od.FOLLOWING_WINDOW), window),
            (od.FOLLOWING_TIME, drive.find(od.FOLLOWING_TIME), FOLLOWING_MS),
        ]
        off = position_range(low, high) is None
        result = []
        for what, found, want in wanted:
            if found is None:
                continue
            free = off and what.index == od.POSITION_LIMIT_LOW.index
            free = free or (what is od.MAX_TORQUE and found == 0)  # as shipped, or refused before
            result.append((what, found, want if free else tighter(what, found, want)))
        return result

    def _torque_protection(self, permille: int) -> list[tuple[Object, int | None, int]]:
        drive = self._drive
        present = drive.find(od.MAX_TORQUE)
        if present is not None:
            return [(od.MAX_TORQUE, present, permille)]
        limit, nominal = drive.vendor.torque_limit, drive.vendor.nominal_current
        rated = None if limit is None or nominal is None else drive.find(nominal)
        if limit is None or not rated:
            return []
        return [(limit, drive.find(limit), max(1, rated * permille // 1000))]

    def unwritable(self, scaling: Scaling, limits: EffectiveLimits) -> list[str]:
        """Limits that are too permissive and cannot be written, in words.

        By the EDS, or found by writing what stands there.
        """
        drive = self._drive
        lacks = []
        for what, found, wanted in self._wanted(scaling, limits):
            if found != wanted and not drive.takes(what, found):
                lacks.append(_only_the_master(what, found, wanted))
        return lacks

    def _heartbeat_entry(self) -> tuple[Object, int] | None:
        """The entry of 0x1016 for this master, and what stands there; ``None`` where all watch others."""
        drive = self._drive
        count = drive.find(od.CONSUMER_HEARTBEATS) or 1
        free = None
        for sub in range(1, count + 1):
            what = od.CONSUMER_HEARTBEAT if sub == 1 else Object(0x1016, sub, "I", "consumer heartbeat")
            data = drive.peek(what)
            if data is None:
                continue
            found = what.unpack(data)
            node, ms = watched(found)
            if node == MASTER_ID and ms:
                return what, found
            if free is None and (not node or not ms):
                free = what, found
        return free

    def heartbeat_lacks(self) -> list[str]:
        """Where the drive would not notice the master's death, in words; DriveError where it must notice."""
        drive = self._drive
        entry = self._heartbeat_entry()
        if entry is None:
            if not drive.config.allow_missing_heartbeat:
                raise DriveError(
                    sentence(
                        "{who}: every entry of 0x1016 watches another node, none is free to watch this "
                        "computer: if it dies, the axis keeps its last torque. Free one with the drive's "
                        "tool, or, where another device stops the axis then, set allow_missing_heartbeat: "
                        "true for it",
                        who=drive.who,
                    ),
                    axis=drive.name,
                )
            return ["0x1016 consumer heartbeat: every entry watches another node, none this master"]
        node, ms = watched(entry[1])
        if node == MASTER_ID and 0 < ms < self._watch_ms * 2 // 3:
            raise DriveError(
                sentence(
                    "{who}: 0x1016 of the drive watches this master for {ms} ms, and is not loosened; "
                    "set safety.heartbeat_s to {heartbeat_s:g} at most: three heartbeats must fit",
                    who=drive.who,
                    ms=ms,
                    heartbeat_s=ms // 3 / 1000,
                ),
                axis=drive.name,
            )
        return []

    def _stop(self, scaling: Scaling, limits: EffectiveLimits) -> tuple[int | None, Stop]:
        """0x605A as it will be (``None``: nobody knows), and the stop that it makes."""
        drive = self._drive
        found, option = drive.find(od.QUICK_STOP_OPTION), drive.vendor.quick_stop_default
        if found is not None:
            option = tighter(od.QUICK_STOP_OPTION, found, self.quick_stop_option)
        return option, stop_of(drive, scaling, option, limits.torque.value)

    def stopping(self, scaling: Scaling, limits: EffectiveLimits, timer_ms: int | None) -> StoppingFacts:
        """How the drive will stop, with what is written into it before it is enabled."""
        drive = self._drive
        entry = None if drive.find(od.CONSUMER_HEARTBEAT) is None else self._heartbeat_entry()
        watch_ms = None
        if entry is not None:
            _, watch_ms = watched(tighter_watch(entry[1], MASTER_ID, self._watch_ms))
        option, stop = self._stop(scaling, limits)
        stays = option is not None and option not in SWITCHES_OFF
        return stopping_facts(drive, scaling, stop, stays=stays, watch_ms=watch_ms, timer_ms=timer_ms)

    def write(self, scaling: Scaling, limits: EffectiveLimits) -> None:
        """Write the limits, never less than the drive has; those it does not take are in ``notes``."""
        drive = self._drive
        self.notes = ()
        entry = None if drive.find(od.CONSUMER_HEARTBEAT) is None else self._heartbeat_entry()
        if entry is not None:
            drive.write(entry[0], tighter_watch(entry[1], MASTER_ID, self._watch_ms))
        for what, wanted in (
            (od.PRODUCER_HEARTBEAT, self._beat_ms),
            (od.ABORT_CONNECTION, 3),  # quick stop
        ):
            found = drive.find(what)
            if found is None:
                continue
            try:
                drive.write(what, tighter(what, found, wanted))
            except WriteRefused:
                if what is not od.PRODUCER_HEARTBEAT:
                    raise
                self.notes += (
                    f"axis {drive.name}: {what.address} takes no {wanted} ms and stays {found}: the master "
                    "only notices by missing TPDOs when the drive dies",
                )
        self._write_quick_stop_option()
        self._write_ramp(scaling, limits)
        for what, found, wanted in self._wanted(scaling, limits):
            if found == wanted:
                continue  # tight enough, read-only or not
            try:
                drive.write(what, wanted)
            except WriteRefused:
                self.notes += (f"axis {drive.name}: {_only_the_master(what, found, wanted)}",)

    def _write_quick_stop_option(self) -> None:
        """Write 0x605A: stop on the ramp, then stay or switch off; another way to stay does as well."""
        drive, what, wanted = self._drive, od.QUICK_STOP_OPTION, self.quick_stop_option
        found = drive.find(what)
        if found is None or (wanted == STAY and found in STAYING):
            return
        try:
            drive.write(what, wanted)
        except WriteRefused:
            if wanted == STAY:
                raise
            self.notes += (f"axis {drive.name}: {what.address} is {found} and cannot be written",)

    def _write_ramp(self, scaling: Scaling, limits: EffectiveLimits) -> None:
        """Write the deceleration of the quick stop that was stated before."""
        _, stop = self._stop(scaling, limits)
        if stop.write is None:
            return
        try:
            self._drive.write(*stop.write)
        except WriteRefused:
            self.notes += (
                f"axis {self._drive.name}: {stop.write[0].address} {stop.write[0].name} cannot be written: "
                "it may take longer to stop than was stated",
            )


def _only_the_master(what: Object, found: int, wanted: int) -> str:
    return (
        f"{what.address} {what.name}: it is {found}, {wanted} is wanted, and it cannot be written; only the "
        f"master watches {WATCHED.get(what.index, 'that')}"
    )
