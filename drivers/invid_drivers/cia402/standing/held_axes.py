"""The axes of a cell and what holds them: before the drives are enabled, at rest, and after the stop."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Mapping, Sequence

from invid.errors import BusError, SafetyStop
from invid.sweep.loads import LOAD_SHARE
from invid.sweep.ports import Sample
from invid.wording.sentence import sentence
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.axis import Drive, DriveReport
from invid_drivers.cia402.cycle import Cycle
from invid_drivers.cia402.journal import Entry, Journal
from invid_drivers.cia402.protection import STAY, SWITCH_OFF
from invid_drivers.cia402.standing.hold_memory import HoldMemory
from invid_drivers.cia402.standing.holding import (
    AxisHolding,
    Reason,
    energised_reason,
    found_holding,
    require_holdable,
    settle,
    suspect_reason,
)
from invid_drivers.cia402.states import DriveState, is_energised, state_of

DEAD_PERMILLE = 5
"""A drive without voltage shows at most half a per cent of rated torque, the noise of current sensing."""


class HeldAxes:
    """How each axis of a cell is held, and what is written and remembered for it."""

    def __init__(self, drives: Sequence[Drive], journal: Journal) -> None:
        self._drives, self._journal = drives, journal
        self.memory = HoldMemory.beside(journal.path)
        """What was seen of how each drive holds its axis."""
        self.holdings: list[AxisHolding] = []
        self._settled = False

    def find(self, reports: Sequence[DriveReport], powered: Mapping[str, DriveState]) -> None:
        """Ask each drive how it holds; DriveError where nothing would hold an axis that is or may be loaded.

        ``powered``: states of drives that were not sent anything.
        """
        self.holdings, self._settled = [], False
        for drive, report in zip(self._drives, reports, strict=True):
            state = powered.get(drive.name, DriveState.SWITCH_ON_DISABLED)
            holding = found_holding(drive, state, self.memory, report)
            if not holding.is_left_alone:
                if holding.seen.left_held or holding.seen.in_run:
                    holding.note(self.memory, left_held=False, in_run=False)
                require_holdable(drive, holding)
            self.holdings.append(holding)

    @property
    def not_ready(self) -> tuple[Reason, ...]:
        """Reasons against measuring: axes that are energised, and axes at which the last run ended."""
        powered = (
            energised_reason(h.config.name, h.config.node_id, h.state, h.seen.resumes)
            for h in self.holdings
            if is_energised(h.state)
        )
        suspects = (
            suspect_reason(h.config.name, h.config.node_id, h.seen.suspect)
            for h in self.holdings
            if h.seen.suspect
        )
        return (*suspects, *powered)

    def clear(self, names: Sequence[str]) -> None:
        """Let these axes be enabled again: a person has found the cause."""
        for drive in self._drives:
            if drive.name in names:
                self.memory.clear(drive.node_id, drive.of_node.number)

    def suspect(self, axes: Collection[str], why: str) -> None:
        """Remember the axes at which a run ended, where any axis carries a load.

        What moves an axis that carries nothing moves the loaded ones that are coupled to it.
        """
        if not any(h.loaded for h in self.holdings):
            return
        named = {name for axis in axes for name in axis.split(", ")}  # a node may have several
        for h in self.holdings:
            if h.config.name in named:
                with contextlib.suppress(BusError):  # the error that is on its way says more
                    h.note(self.memory, suspect=why[:200])

    def too_heavy(self, axis: int, weight: int) -> None:
        """Remember that the load of an axis needs so many thousandths of rated torque at least."""
        self.holdings[axis].loaded = True
        with contextlib.suppress(BusError):  # the error that is on its way says more
            self.holdings[axis].note(self.memory, loaded=True, weight=weight)

    # --- at rest -------------------------------------------------------------------------------
    def weigh_at_once(
        self, sample: Sample, rated: Sequence[float], held: Sequence[bool], driven: Collection[int]
    ) -> None:
        """Keep held what shows torque at a stop before the one at rest was judged.

        That counts where the drive holds the axis, for nobody else commands it, and not of one that is
        ``driven`` by that torque.
        """
        for i, h in enumerate(self.holdings):
            doubted = not self._settled and h.loaded is False and h.can_stay and sample.fresh[i]
            doubted = doubted and i not in driven and held[i] and is_energised(state_of(sample.status[i]))
            if doubted and abs(sample.torque[i]) > LOAD_SHARE * rated[i]:
                h.loaded = True

    @property
    def doubted(self) -> set[int]:
        """Axes that stay held only because nobody has weighed them yet."""
        return {
            i
            for i, h in enumerate(self.holdings)
            if not self._settled and h.stays and not h.config.gravity_loaded and not h.seen.loaded
        }

    def settle(self, loaded: Sequence[bool], weights: Sequence[int]) -> None:
        """Take over what the torque at rest said; DriveError where nothing will hold a loaded axis."""
        self._settled = True
        settle(self.holdings, loaded, weights, self.memory)
        for drive, holding in zip(self._drives, self.holdings, strict=True):
            if holding.loaded and holding.stays and not holding.can_stay:
                require_holdable(drive, holding)

    def refuse_dead_displays(
        self, sample: Sample, off: Mapping[int, float], reports: Sequence[DriveReport]
    ) -> None:
        """SafetyStop where a load cannot be weighed: 0x6077 is the same with and without voltage."""
        for i, (h, report) in enumerate(zip(self.holdings, reports, strict=True)):
            shown, unit = off.get(i, 0.0), abs(report.scaling.torque(1))
            if h.loaded and abs(shown) > DEAD_PERMILLE * unit and sample.torque[i] == shown:
                raise SafetyStop(
                    sentence(
                        "axis {axis}: 0x6077 showed {shown:.0f} ‰ of rated torque before the drive was "
                        "switched on and shows it while it holds a load: it is not its torque",
                        axis=h.config.name,
                        shown=shown / unit,
                    ),
                    axis=h.config.name,
                )

    def note_begin(self) -> None:
        """Remember, before power, that a run commands these axes: whoever kills it leaves that behind."""
        self.memory.file.defer()
        for h in self.holdings:
            h.note(self.memory, in_run=True)
        self.memory.file.settle()

    def set_options(self, cycle: Cycle) -> bool:
        """Have 0x605A written where a drive must hold a load and was to switch off; whether any is."""
        asked, what = False, od.QUICK_STOP_OPTION
        for i, (drive, holding) in enumerate(zip(self._drives, self.holdings, strict=True)):
            must_stay = holding.loaded is not False and drive.protection.quick_stop_option != STAY
            if must_stay and holding.can_stay and holding.option_writable:
                drive.protection.quick_stop_option = STAY
                before, after = (what.pack(v).hex() for v in (SWITCH_OFF, STAY))
                index = drive.of_node.at(what).index
                self._journal.note(Entry(drive.node_id, drive.serial, index, what.sub, before, after))
                cycle.set_object(i, what, STAY)
                asked = True
        return asked

    # --- after the stop ------------------------------------------------------------------------
    def note_end(self, held: Sequence[str], not_off: Sequence[str]) -> None:
        """Remember which axes their drives hold, and which were not seen to switch off."""
        for h in self.holdings:
            is_held = h.config.name in held
            with contextlib.suppress(BusError):
                h.note(self.memory, left_held=is_held, in_run=h.config.name in not_off)
            if is_held:
                h.state, h.taken_over = DriveState.QUICK_STOP_ACTIVE, True

    def endings(
        self, held: Sequence[str], unseen: Sequence[str], not_held: Sequence[str], sample: Sample
    ) -> tuple[str, ...]:
        """Axes energised after the stop, by what, and what to do; and loaded ones that were not seen to
        stand, or of which nothing came in the end."""
        said = [
            f"axis {name} is energised: it is held by its drive in quick stop active, with its limits and "
            "its heartbeat watch, which are restored when it is off. To have it off, support its load or set "
            "its brake, then take the drive's enable or supply away and run `invid check`; the next "
            "measurement takes it over as it is"
            for name in held
            if name not in not_held or self._brake_failed(name)
        ]
        for i, h in enumerate(self.holdings):
            name = h.config.name
            if name not in not_held:
                continue
            state = state_of(sample.status[i])
            carries = "carries a load" if h.loaded else "may carry a load"
            if name in held and self._brake_failed(name):
                said.append(
                    f"axis {name}: its brake was seen not to hold it after the stop; see to the brake"
                )
            elif name in unseen:
                said.append(
                    f"axis {name} {carries}, says nothing any more ({state.words} was the last) and may be "
                    "energised: nothing was seen to hold it. Support it before anybody goes near, then take "
                    "the drive's enable or supply away"
                )
            elif name in held or is_energised(state):
                said.append(
                    f"axis {name} {carries}, is energised ({state.words}) and is not held: its drive was not "
                    "seen to bring it to rest. Support it before anybody goes near, then take the drive's "
                    "enable or supply away"
                )
            else:
                said.append(
                    f"axis {name} {carries} and is without torque ({state.words}): nothing was seen to "
                    "hold it. Support it before anybody goes near"
                )
        return tuple(said)

    def _brake_failed(self, name: str) -> bool:
        return any(h.config.name == name and h.brake_failed for h in self.holdings)
