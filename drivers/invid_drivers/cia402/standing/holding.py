"""How each axis of a cell is held when nobody commands it: by its drive, by its brake, or not at all.

An axis of which it is not known whether it carries a load counts as loaded until the torque that holds it at
rest has told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from invid.config import AxisConfig, CellConfig
from invid.errors import DriveError
from invid.sweep.axis_estimator import STAND_S
from invid.wording.sentence import capital, marked, sentence
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.access import Access
from invid_drivers.cia402.axis import Drive, DriveReport
from invid_drivers.cia402.protection import STAY, STAYING, SWITCH_OFF
from invid_drivers.cia402.standing.hold_memory import HoldMemory, Seen, identity
from invid_drivers.cia402.states import DriveState, is_energised

BRAKE_MARGIN = 2.0
"""On the time that a brake was seen to take."""
DROP_SHARE = 0.02
"""Of the window: a brake that lets an axis fall further is too late to hold it."""
SEEN_S = 0.1
"""A fall is seen by then, of 1, 3 and 10 rad/s² after 74, 42 and 26 ms (16 bits, 2 ms), with what the speed
that was measured lags."""
CLOSES_S = (0.1, 0.3)
"""Brakes that close late take so long."""


@dataclass
class AxisHolding:
    """One axis: what is stated, what was found, what was seen."""

    config: AxisConfig
    identity: str
    seen: Seen
    state: DriveState
    option: int | None
    """0x605A as found; ``None``: the drive has none."""
    option_writable: bool
    has_position_mode: bool = True
    limit: int = 32767
    """Thousandths of rated torque that its drive will be permitted."""
    watched: bool = True
    """The drive notices that its master is gone (0x1016)."""

    def __post_init__(self) -> None:
        self.taken_over = self.state is DriveState.QUICK_STOP_ACTIVE
        """Held by its drive since an earlier run: never let go before it is known what it carries."""
        self.loaded = self.config.gravity_loaded
        """``None``: not known yet."""
        self.brake_failed = False
        """It was seen not to hold the axis after the stop, and the drive was seen to."""
        self.brake_tried = self.stop_tried = False
        """In this run: what was seen before does not replace a look."""
        if self.seen.loaded:
            self.loaded = True
        elif self.taken_over and self.loaded is False:
            self.loaded = None  # somebody left it held: the statement may be wrong

    @property
    def can_stay(self) -> bool:
        """Whether 0x605A can have a value with which the drive stays in quick stop active."""
        return self.option is not None and (self.option_writable or self.option in STAYING)

    @property
    def brake_in_time(self) -> bool | None:
        """Whether its brake closes before it falls too far; ``None``: no brake, or not measured."""
        if self.config.brake != "drive" or self.seen.brake_drop is None:
            return None
        return self.seen.brake_drop <= self.most_drop

    @property
    def rest_s(self) -> float | None:
        """Seconds after which it stands without torque; ``None`` where nothing was seen to hold it then."""
        if self.loaded is False:
            return 0.0
        closes = self.brake_tried and self.brake_in_time and self.seen.brake_s is not None
        return BRAKE_MARGIN * (self.seen.brake_s or 0.0) + STAND_S if closes else None

    @property
    def most_drop(self) -> float:
        """How far the axis may fall until its brake holds it [rad or m]."""
        return DROP_SHARE * self.config.limits.position

    @property
    def stays(self) -> bool:
        """Whether the drive must go on holding it when the master lets go."""
        by_drive = self.config.brake != "drive" or self.brake_in_time is False
        return self.taken_over or (self.loaded is not False and by_drive)

    @property
    def first_option(self) -> int:
        """0x605A before the axis is weighed: its drive may have to hold it, also where a brake did once."""
        return SWITCH_OFF if self.loaded is False or not self.can_stay else STAY

    @property
    def needs_brake_test(self) -> bool:
        """Whether it is loaded and its brake was not measured in this run."""
        return bool(self.loaded) and self.config.brake == "drive" and not self.brake_tried

    @property
    def needs_stop_test(self) -> bool:
        """Whether it is loaded and its drive, which must hold it, was not seen to do so in this run."""
        return bool(self.loaded) and self.stays and not self.stop_tried

    def note(self, memory: HoldMemory, **seen: bool | float | str | None) -> None:
        """Remember what was seen."""
        self.seen = replace(self.seen, **seen)  # type: ignore[arg-type]
        memory.keep(self.identity, self.seen)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "axis": self.config.name,
            "loaded": self.loaded,
            "state": self.state.words,
            "held_by": self.held_by,
            "seen": asdict(self.seen),
        }

    @property
    def held_by(self) -> str:
        """What holds it: "nothing needed", "drive", "brake", or "not known"."""
        if self.loaded is False:
            return "nothing needed"
        if self.brake_in_time:
            return "brake"
        return "drive" if self.stays and self.seen.holds else "not known"

    @property
    def _falls(self) -> str:
        """What a drive that cannot hold it any more leaves: from a·t²/2, sped up for as long as nobody saw
        it."""
        if self.brake_in_time is not False or not self.seen.falls:
            return "After a fault of the drive itself nothing holds it"
        ways = [0.5 * self.seen.falls * (SEEN_S + seconds) ** 2 for seconds in CLOSES_S]
        return (
            "Where the drive fails, or gives less than its load weighs, it falls until that brake has "
            "closed: " + ", ".join(f"{w:.2g} at most in {s:g} s" for w, s in zip(ways, CLOSES_S, strict=True))
        )

    @property
    def is_left_alone(self) -> bool:
        """Whether nothing is sent to it: it is under power, or what it shows may not be believed."""
        return is_energised(self.state) or bool(self.seen.suspect)

    def said(self, who: str) -> str:
        """How it is held, as a sentence for ``check``; empty where it carries nothing."""
        if self.loaded is False:
            return ""
        carries = (
            f"{who}: carries a load" if self.loaded else f"{who}: whether it carries a load is not known"
        )
        if self.brake_in_time:
            return (
                f"{carries}; its brake holds it (it closes within {self.seen.brake_s:.2g} s, seen to let it "
                f"move {self.seen.brake_drop:.2g})"
            )
        late = ", for its brake was seen to close too late" if self.brake_in_time is False else ""
        if self.seen.holds:
            return (
                f"{carries}; its drive holds it after a quick stop and without its master (seen){late}. "
                f"{self._falls}"
            )
        what = "brake" if self.config.brake == "drive" and not late else "quick stop"
        return (
            f"{carries}, and its {what} was not seen to hold it{late}: the next measurement tries that at "
            "rest first"
            + ("" if self.loaded else ", if it is loaded")
            + ". Support it so that it cannot fall far"
        )


def found_holding(drive: Drive, state: DriveState, memory: HoldMemory, report: DriveReport) -> AxisHolding:
    """How a drive holds its axis, by what stands in it and in the memory; writes nothing under power."""
    name = identity(report.vendor_id, report.product_code, report.serial, drive.of_node.number)
    option = drive.find(od.QUICK_STOP_OPTION)
    writable = option is not None and (
        is_energised(state)
        or drive.left_alone
        or option in STAYING
        or drive.takes(od.QUICK_STOP_OPTION, option)
    )
    return AxisHolding(
        drive.config,
        name,
        memory.of(name, drive.node_id, drive.of_node.number),
        state,
        option,
        writable,
        report.can_hold,
        report.scaling.most_permille(report.limits.torque.value),
        drive.find(od.CONSUMER_HEARTBEAT) is not None,
    )


_UNLOADED = sentence("where it does not fall without torque, set gravity_loaded: false")


def require_holdable(drive: Access, holding: AxisHolding) -> None:
    """DriveError where nothing would hold an axis that is or may be loaded."""
    h = holding
    if h.loaded is False:
        return
    if not h.has_position_mode:
        raise DriveError(
            sentence(
                "{who}: {load}, and the drive has no cyclic synchronous position (0x6502): it "
                "would begin without torque and fall, brake or not. Use a drive that can hold its "
                "place by itself, or unload the axis{otherwise}",
                who=drive.who,
                load=_load(h),
                otherwise="" if h.loaded else sentence("; {unloaded}", unloaded=_UNLOADED),
            )
        )
    if h.seen.weight is not None and h.seen.weight > h.limit:
        raise DriveError(
            sentence(
                "{who}: it took {weight} ‰ of rated torque to hold its load, and the limit is "
                "{limit} ‰ now: it would fall. Compare 0x6076 with the motor's plate, or raise the "
                "limit",
                who=drive.who,
                weight=h.seen.weight,
                limit=h.limit,
            ),
            axis=drive.name,
        )
    if h.can_stay or (h.config.brake == "drive" and h.brake_in_time is not False):
        return
    why = (
        sentence("it has no 0x605A")
        if h.option is None
        else sentence("its 0x605A is {option} and cannot be written", option=h.option)
    )
    late = sentence("; its brake was seen to close too late") if h.brake_in_time is False else ""
    way_out = sentence(
        "use a drive that can, give the axis a brake that its drive closes (brake: drive), or unload it"
    )
    if not h.loaded:
        way_out = sentence("{unloaded}; else {way_out}", unloaded=_UNLOADED, way_out=way_out)
    raise DriveError(
        sentence(
            "{who}: {load}, and it is not known that its drive holds it after a quick stop or "
            "without its master: {why}{late}. It would fall; {way_out}",
            who=drive.who,
            load=_load(h),
            why=why,
            late=late,
            way_out=way_out,
        ),
        axis=drive.name,
    )


def _load(holding: AxisHolding) -> str:
    return sentence("loaded") if holding.loaded else sentence("perhaps loaded (gravity_loaded is not stated)")


@dataclass(frozen=True)
class Reason:
    """Why a cell is not ready: a stable code, a sentence, the way out."""

    code: Literal["axis_energised", "axis_suspect"]
    text: str
    fix: str
    axis: str
    node_id: int
    taken_over: bool = False
    """Nothing to wait for: the next measurement takes it over without letting go, or finds it off."""
    at: float | None = None
    """When that was seen [s since 1970]; ``None``: now."""

    @property
    def sentences(self) -> tuple[str, str]:
        """What is the matter, and what to do."""
        return self.text, capital(self.fix)


def energised_reason(name: str, node_id: int, state: DriveState, resumes: bool | None) -> Reason:
    """The reason of an axis that is under power before anybody asked for it."""
    if state is DriveState.QUICK_STOP_ACTIVE:
        stuck = marked(
            "axis {axis} (node {node}) is energised: its drive holds it in {words}; its drive "
            "does not go back "
            "to operation from there (transition 16)"
        )
        taken = marked(
            "axis {axis} (node {node}) is energised: its drive holds it in {words}; the next "
            "measurement takes "
            "it over without letting go"
        )
        return Reason(
            "axis_energised",
            sentence(stuck if resumes is False else taken, axis=name, node=node_id, words=state.words),
            sentence(
                "to have it off, support its load or set its brake, then take the drive's "
                "enable or supply away "
                "and run `invid check`"
            ),
            name,
            node_id,
            taken_over=resumes is not False,
        )
    return Reason(
        "axis_energised",
        sentence(
            "axis {axis} (node {node}) is energised: its drive is in {words}, and not by this program",
            axis=name,
            node=node_id,
            words=state.words,
        ),
        sentence(
            "end the program that drives it; or support its load, take the drive's enable or "
            "supply away, and "
            "run `invid check`"
        ),
        name,
        node_id,
    )


def suspect_reason(name: str, node_id: int, why: str) -> Reason:
    """The reason of an axis at which the last run ended beside a load."""
    return Reason(
        "axis_suspect",
        sentence(
            "the last run ended at axis {axis} (node {node}), beside a load or under one "
            "({why}): what was wrong "
            "may still be, and enabling it may drop the load",
            axis=name,
            node=node_id,
            why=why,
        ),
        sentence("find the cause; then `invid check --cleared {axis}`", axis=name),
        name,
        node_id,
    )


def unended_reason(name: str, node_id: int) -> Reason:
    """The reason of an axis whose run was killed: nobody has looked at its drive since."""
    return Reason(
        "axis_energised",
        sentence(
            "axis {axis} (node {node}) may be energised: a run that commanded it did not end in "
            "order, and its "
            "drive was not asked since",
            axis=name,
            node=node_id,
        ),
        sentence("make sure of it; `invid check` asks its drive, and the next measurement does"),
        name,
        node_id,
        taken_over=True,
    )


def remembered(config: CellConfig, memory: HoldMemory) -> tuple[Reason, ...]:
    """Reasons by the memory alone, as of when it was noted: axes left energised, or in a run that was killed,
    and not seen off since; axes under suspicion.
    """
    found = []
    for axis in config.axes:
        seen = memory.of_axis(axis.node_id, axis.axis_of_node)
        if seen is None:
            continue
        if seen.suspect:
            found.append(suspect_reason(axis.name, axis.node_id, seen.suspect))
        if seen.left_held:
            state = DriveState.QUICK_STOP_ACTIVE
            found.append(replace(energised_reason(axis.name, axis.node_id, state, seen.resumes), at=seen.at))
        elif seen.in_run:
            found.append(replace(unended_reason(axis.name, axis.node_id), at=seen.at))
    return tuple(found)


def to_support(config: CellConfig, memory: HoldMemory) -> tuple[str, ...]:
    """Axes whose hold the next measurement tries: their loads must not be able to fall far."""
    names = []
    for axis in config.axes:
        seen = memory.of_axis(axis.node_id, axis.axis_of_node) or Seen(axis.node_id)
        if axis.gravity_loaded is False and not seen.loaded:
            continue
        tried = seen.brake_drop is not None if axis.brake == "drive" else seen.holds is True
        if not tried or (axis.brake == "drive" and _late(axis, seen) and not seen.holds):
            names.append(axis.name)
    return tuple(names)


def _late(axis: AxisConfig, seen: Seen) -> bool:
    return seen.brake_drop is not None and seen.brake_drop > DROP_SHARE * axis.limits.position


def settle(
    holdings: Sequence[AxisHolding], loaded: Sequence[bool], weights: Sequence[int], memory: HoldMemory
) -> None:
    """Note which axes are loaded, as the torque at rest said.

    ``weights``: thousandths of rated torque that hold each axis.
    """
    for h, carries, weight in zip(holdings, loaded, weights, strict=True):
        h.loaded = bool(carries)
        h.taken_over = False
        if carries:
            h.note(memory, loaded=True, weight=weight)
        elif h.seen.loaded:
            h.note(memory, loaded=False, weight=None)
