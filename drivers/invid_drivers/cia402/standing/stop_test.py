"""The stop test: at rest, load supported, each loaded axis is stopped as it may be later, and watched.

A brake is tried by taking the voltage away. A drive that must hold by itself is tried by a quick stop, by
silence of the master in quick stop active and by transition 16 back to operation; then by quick stop and
silence once more from torque mode with the load's torque, for that is where real stops and dead masters
find it. SYNC goes on but in the silences. What lets go is caught at once: enabled with the torque of its
load, then held in position mode.
"""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Collection, Sequence
from statistics import fmean

from invid.errors import BusError, DriveError, InvidError, SafetyStop
from invid.sweep.loads import LOAD_SHARE
from invid.sweep.ports import Mode, Sample, Severity
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402 import states
from invid_drivers.cia402.link import NMT_START
from invid_drivers.cia402.standing.hold_memory import HoldMemory
from invid_drivers.cia402.standing.holding import AxisHolding
from invid_drivers.cia402.standing.moving_cell import UNSEEN, MovingCell
from invid_drivers.cia402.standing.standstill import STAND_S, Standstill, tolerances
from invid_drivers.cia402.states import DriveState, OperationMode, is_energised, state_of

HOLD_S = 0.4
"""Watched after a quick stop: longer than the ramp from rest, and than a drive takes to switch itself off."""
BRAKE_S = 2.0
"""Longest time until a brake has closed."""
SETTLE_S = 2.0
"""What the axis did before has died away by then."""
RESUME_S = 3.0
"""Longest way back to operation enabled."""
TORQUE_S = 0.12
"""In torque mode before it is stopped: some drives show a mode 0.1 s before it acts."""
DRIFT_S = 0.3
"""Longest heartbeat watch that is waited for in torque mode: with its load's torque alone an axis drifts,
by 1 % of rated torque on 1 kg·m² by 5 mrad until then; else it is waited for in position mode."""
SUPPORT_S, SUPPORTED_S = 30.0, 0.5
"""Longest wait for a person to support a load that its drive let go; and how long it must rest on it."""
LOOK_S = 0.005
"""Between two looks at a drive whose master is silent."""
ANSWER_S = 1.0
"""Waited for an answer that does not come, before the bus is called broken."""
SILENCE_S = 0.2
"""Beyond the drive's heartbeat watch: what it does then takes its time."""
STILL_SHARE = 0.0005
"""An axis that moved less, as a share of its window, stood."""


def await_support(
    exchange: Callable[[], Sample], axis: int, least: float, most: float, ends: float = math.inf
) -> None:
    """Hold an axis until its load is supported, or ``SUPPORT_S`` are over, or it ``ends``, or it is not held.

    The sign of support is the torque that holds it falling below ``least`` [N·m or N]; one that has gone
    further than ``most`` [rad or m] meanwhile is not held.
    """
    sample = exchange()
    end, since, place = min(sample.time + SUPPORT_S, ends), None, sample.position[axis]
    while sample.time < end and abs(sample.position[axis] - place) <= most:
        if abs(sample.torque[axis]) > least:
            since = None
        elif since is None:
            since = sample.time
        elif sample.time - since >= SUPPORTED_S:
            return
        sample = exchange()


class StopTest:
    """One test of the loaded axes of a cell that its drives hold."""

    def __init__(
        self,
        cell: MovingCell,
        holdings: Sequence[AxisHolding],
        memory: HoldMemory,
        cancelled: Callable[[], bool],
    ) -> None:
        self._cell = cell
        self._config, self._link, self._drives, self._cycle = cell.config, cell.link, cell.drives, cell.cycle
        self._holdings, self._memory = holdings, memory
        self._cancelled = cancelled
        self._still = tolerances(cell.config, cell.resolution, STILL_SHARE)
        self._tried: Collection[int] = ()

    def run(self) -> bool:
        """Test what was not seen in this run; whether anything was tested. All axes are held again by their
        drives.

        Raises
        ------
        SafetyStop
            An axis would fall, or cannot be taken back into operation without letting go.
        """
        brakes = [i for i, h in enumerate(self._holdings) if h.needs_brake_test]
        if brakes:
            self._await_rest(brakes)
            self._try_brakes(brakes)
        stops = [i for i, h in enumerate(self._holdings) if h.needs_stop_test]
        if stops:
            self._await_rest(stops)
            self._try_stop(stops)
        return bool(brakes or stops)

    def _await_rest(self, axes: Sequence[int]) -> None:
        """Wait until axes rest, and take the torque that holds them for that of their loads.

        One that moved before the test says nothing of its brake or drive.
        """
        standing, sample = Standstill(self._still), self._exchange()
        end = sample.time + SETTLE_S
        shown: dict[int, deque[float]] = {
            i: deque(maxlen=round(STAND_S / self._config.bus.cycle_s)) for i in axes
        }
        while not standing.all(sample, axes):
            for i in axes:
                shown[i].append(sample.torque[i])
            if sample.time > end:
                moving = [self._name(i) for i in axes if not standing.stands(i)]
                raise SafetyStop(
                    f"axis {', '.join(moving)}: moves, though its drive is to hold it at rest (before the "
                    "stop test). Somebody moves it, its load is beyond the drive's torque limit, or a sign "
                    "is wrong in it",
                    axes=moving,
                )
            sample = self._exchange()
        for i in axes:
            if self._cell.torque_modes[i] is not OperationMode.CYCLIC_POSITION:  # an offset adds to its loop
                self._cycle.support[i] = fmean(shown[i])

    # --- brakes --------------------------------------------------------------------------------
    def _try_brakes(self, axes: Sequence[int]) -> None:
        """Switch the drives off and measure when and how far each axis moved last.

        One that moves further than a brake in time lets it is caught by its drive, which must hold it then.
        """
        sample = self._exchange()
        start, began = list(sample.position), sample.time
        place, moved_at = list(start), [began] * len(start)
        drop = [0.0] * len(start)
        waiting = set(axes)
        for i in axes:
            self._cycle.control[i] = states.DISABLE_VOLTAGE
        while waiting:
            sample = self._exchange()
            for i in sorted(waiting):
                if not sample.fresh[i]:
                    moved_at[i] = sample.time  # nobody knows
                    continue
                drop[i] = max(drop[i], abs(sample.position[i] - start[i]))
                if abs(sample.position[i] - place[i]) > self._still[i]:
                    place[i], moved_at[i] = sample.position[i], sample.time
                late = drop[i] > self._holdings[i].most_drop
                if late or sample.time - moved_at[i] > STAND_S:
                    waiting.discard(i)
                    self._holdings[i].brake_tried = True
                    self._note(i, brake_s=max(0.0, moved_at[i] - began), brake_drop=drop[i])
                if late:
                    self._catch([i])
            if waiting and sample.time - began > BRAKE_S:
                names = [self._name(i) for i in sorted(waiting)]
                raise BusError(
                    f"axis {', '.join(names)}: no answer for {BRAKE_S:g} s while its brake was tried",
                    axes=names,
                )
        for i in axes:
            if self._holdings[i].stays and not self._holdings[i].can_stay:
                raise SafetyStop(
                    f"axis {self._name(i)}: its drive was switched off at rest, it fell by "
                    f"{drop[i]:.2g} and its brake "
                    "did not hold it by then, and its drive cannot (0x605A; stop test). See to the "
                    "brake, or unload it",
                    axis=self._name(i),
                )
        self._enable(axes)

    # --- drives --------------------------------------------------------------------------------
    def _try_stop(self, axes: Sequence[int]) -> None:
        """Try quick stop, silence and the way back, from position and from torque mode; the others are
        off."""
        others = [i for i in range(len(self._drives)) if i not in axes]
        watched = [i for i in axes if self._holdings[i].watched]
        try:
            start = self._quick_stop(axes, "after a quick stop")
            for i in others:
                stays = self._holdings[i].stays
                self._cycle.control[i] = states.QUICK_STOP if stays else states.DISABLE_VOLTAGE
            self._watch(HOLD_S, axes, start, "after a quick stop")
            if watched:
                self._fall_silent(watched, start)
            self._resume(axes)
            if self._in_torque_mode(axes):
                self._quick_stop(axes, "after a quick stop from torque mode")
                self._resume(axes)
                if 3 * self._config.safety.heartbeat_s <= DRIFT_S:
                    self._in_torque_mode(axes)
            if watched:
                self._fall_silent(watched, self._exchange().position)
            self._resume(axes)
        except SafetyStop as error:
            caught = [i for i in self._tried if error.axis == self._name(i)]
            if not caught:
                raise
            self._catch(caught)
            raise self._lets_go(caught[0], f"in the stop test: {error.reason}") from None
        for i in axes:
            self._holdings[i].stop_tried = True
            self._note(i, holds=True, resumes=True)
        self._enable(others)

    def _quick_stop(self, axes: Sequence[int], when: str) -> list[float]:
        """Stop axes at rest and see them held; where each stood before."""
        start = list(self._exchange().position)
        self._tried = axes
        for i in axes:
            self._cycle.control[i] = states.QUICK_STOP
        self._watch(HOLD_S, axes, start, when)
        return start

    def _in_torque_mode(self, axes: Sequence[int]) -> bool:
        """Hand axes over to the torque of their loads; False where their drives are shaken in position
        mode."""
        self._await_rest(axes)
        led = [i for i in axes if self._cell.torque_modes[i] is not OperationMode.CYCLIC_POSITION]
        self._tried = axes
        for i in led:
            self._cycle.change(i, Mode.TORQUE, self._cell.torque_modes[i])
        sample = self._exchange()
        while self._cycle.changing:
            sample = self._exchange()
        end = sample.time + (TORQUE_S if led else 0.0)
        while sample.time < end:
            sample = self._exchange()
        return bool(led)

    def _watch(self, seconds: float, axes: Sequence[int], start: Sequence[float], when: str) -> None:
        """Watch that each axis stays in quick stop active and in place, and stands; SafetyStop where one
        does not.

        Each is judged by an answer of its own after that time: one that was late says nothing about its hold.
        """
        sample, standing = self._exchange(), self._cell.standstill()
        end = sample.time + seconds
        silent = set(axes)
        while silent and sample.time < end + ANSWER_S:
            sample = self._exchange()
            standing.all(sample, axes)
            self._require_held(sample, axes, start, when)
            for i in silent.copy():
                if sample.time < end or not sample.fresh[i] or not standing.stands(i):
                    continue
                silent.remove(i)
                state = state_of(sample.status[i])
                if state is not DriveState.QUICK_STOP_ACTIVE:
                    raise self._lets_go(i, f"{when} its drive is in {state.words}")
        if silent:
            i = min(silent)
            if sample.fresh[i]:
                self._catch([i])
                raise self._lets_go(i, f"{when} it did not come to rest")
            names = [self._name(i) for i in sorted(silent)]
            raise BusError(
                f"axis {', '.join(names)}: no answer for {ANSWER_S:g} s {when}, in the stop test", axes=names
            )

    def _require_held(self, sample: Sample, axes: Sequence[int], start: Sequence[float], when: str) -> None:
        """Catch an axis in the cycle in which its drive lets go or it leaves its place."""
        for i in axes:
            state, moved = state_of(sample.status[i]), abs(sample.position[i] - start[i])
            if not sample.fresh[i]:
                continue
            if not is_energised(state):
                what = f"{when} its drive is in {state.words}"
            elif moved > max(self._holdings[i].most_drop, self._still[i]):
                what = f"{when} it moved by {moved:.2g} {'m' if self._config.linear else 'rad'}"
            else:
                continue
            self._catch([i])
            raise self._lets_go(i, what)

    def _catch(self, axes: Sequence[int]) -> None:
        """Enable axes again with the torque of their loads, then in position mode, and hold them until
        supported.

        Whoever does not support them in time has loads that nothing holds. A brake that was late needs
        nobody: its drive goes on holding the axis.
        """
        brakes = [i for i in axes if self._cycle.control[i] == states.DISABLE_VOLTAGE]
        for i in axes:
            if self._holdings[i].has_position_mode:
                self._cell.begin_to_hold(i)
            if i not in brakes:
                self._note(i, holds=False)
        sample = self._unwatched()
        end = sample.time + RESUME_S
        while sample.time < end:
            there = [self._cell.step_to_enabled(i, sample) for i in axes]
            if all(there) and not self._cycle.changing:
                break
            sample = self._unwatched()
        for i in axes:
            if i not in brakes:
                self._cell.tell(UNSEEN.format(self._name(i)))
                least, most = LOAD_SHARE * self._cell.rated[i], self._holdings[i].most_drop
                await_support(self._unwatched, i, least, most)

    def _unwatched(self) -> Sample:
        """One cycle in which nothing ends what holds an axis."""
        sample = self._cycle.exchange(self._cycle.support)
        sample.events = []
        return sample

    def _lets_go(self, axis: int, what: str) -> SafetyStop:
        self._note(axis, holds=False)
        return SafetyStop(
            f"axis {self._name(axis)}: it carries a load, and {what} (stop test at rest): its drive would "
            "let it fall. Use a brake that the drive closes (brake: drive), another drive, or unload the "
            "axis",
            axis=self._name(axis),
        )

    def _fall_silent(self, axes: Sequence[int], start: Sequence[float]) -> None:
        """Send nothing for as long as the drives' heartbeat watch is, and more; then look."""
        link = self._link
        start = list(start)
        self._tried = axes
        link.beating = False
        watch = 3 * self._config.safety.heartbeat_s
        began = link.clock.now()
        lost: list[int] = []
        try:
            while link.clock.now() < began + 1.5 * watch + SILENCE_S and not lost:
                # a question is no sign of life of a master
                lost = [i for i in axes if self._is_lost(i, start[i])]
                link.wait(LOOK_S)
        finally:  # a stop ends the silence as well
            link.beating = True
            for peer in link.peers.values():
                peer.last_heartbeat = None
            for drive in self._drives:
                link.nmt(NMT_START, drive.node_id)  # a drive may leave operational when its master is gone
            self._cycle.restart_slots()
        for peer in link.peers.values():
            for code in peer.own_errors(since=began):
                raise DriveError(
                    f"axis {peer.name} reports error 0x{code:04X} in the stop test", axis=peer.name
                )
        link.events[:] = [e for e in link.events if e.severity is not Severity.DRIVE]
        if lost:
            self._cycle.restart_slots()
            self._catch(lost)
            raise self._lets_go(lost[0], f"without its master for {watch:.2g} s at most its drive let it go")
        link.wait(0.005)
        for i in axes:  # asked before it is commanded anything: what it did by itself
            state = self._state_of(i)
            if state is not DriveState.QUICK_STOP_ACTIVE:
                raise self._lets_go(i, f"without its master for {watch:.2g} s its drive is in {state.words}")
            self._cycle.control[i] = states.QUICK_STOP
        self._cycle.restart_slots()
        self._watch(HOLD_S / 2, axes, start, "without its master")

    def _is_lost(self, axis: int, start: float) -> bool:
        """Whether a drive says that it is without power, or that its axis has left its place."""
        drive = self._drives[axis]
        state = drive.quiet_state()
        if state is not None and not is_energised(state):
            return True
        with contextlib.suppress(InvidError):
            moved = abs(self._cycle.place_of(axis, drive.read(od.POSITION)) - start)
            return moved > max(self._holdings[axis].most_drop, self._still[axis])
        return False

    def _state_of(self, axis: int) -> DriveState:
        """State of a drive by SDO; BusError where no answer comes, which says nothing of its hold."""
        end = self._link.clock.now() + ANSWER_S
        while self._link.clock.now() < end:
            state = self._drives[axis].quiet_state()
            if state is not None:
                return state
        raise BusError(
            f"axis {self._name(axis)}: no answer for {ANSWER_S:g} s after its master was silent, in the "
            "stop test",
            axis=self._name(axis),
        )

    # --- back ----------------------------------------------------------------------------------
    def _resume(self, axes: Sequence[int]) -> None:
        """Go back to operation by transition 16, position mode and present place first."""
        self._hold_here(axes)
        self._tried = ()
        if not self._until_enabled(axes):
            for i in axes:
                if state_of(self._cycle.sample.status[i]) is not DriveState.OPERATION_ENABLED:
                    self._cycle.control[i] = states.QUICK_STOP
                    self._note(i, holds=True, resumes=False)
            raise SafetyStop(
                f"axis {', '.join(self._name(i) for i in axes)}: seen to be held after a quick stop, which "
                "is remembered, but its drive does not go back to operation from there (transition 16). With "
                "the load supported, take its enable or supply away and give it back, then start again",
                axes=[self._name(i) for i in axes],
            )

    def _enable(self, axes: Sequence[int]) -> None:
        """Enable axes that are off or in quick stop active, held where they stand."""
        if not axes:
            return
        self._hold_here(axes)
        if not self._until_enabled(axes):
            names = [self._name(i) for i in axes]
            raise SafetyStop(
                f"axis {', '.join(names)}: not enabled again within {RESUME_S:g} s after the stop test",
                axes=names,
            )

    def _hold_here(self, axes: Sequence[int]) -> None:
        for i in axes:
            if self._holdings[i].has_position_mode:  # another carries nothing, and is without torque
                self._cell.begin_to_hold(i)
        while self._cycle.changing:
            self._exchange()

    def _until_enabled(self, axes: Sequence[int]) -> bool:
        sample = self._exchange()
        end = sample.time + RESUME_S
        while sample.time < end:
            there = [self._cell.step_to_enabled(i, sample) for i in axes]
            if all(there):
                return True
            sample = self._exchange()
        return False

    # --- one cycle -----------------------------------------------------------------------------
    def _exchange(self) -> Sample:
        sample = self._cell.exchange(self._cycle.support)
        for event in sample.events:
            if event.severity is not Severity.NOTE:
                failed = BusError if event.severity is Severity.BUS else DriveError
                raise failed(f"{event.text}, in the stop test", axis=event.axis)
        if self._cancelled():
            raise SafetyStop("stopped on request in the stop test; nothing was recorded yet", code="asked")
        return sample

    def _note(self, axis: int, **seen: bool | float) -> None:
        self._holdings[axis].note(self._memory, **seen)

    def _name(self, axis: int) -> str:
        return self._config.axes[axis].name
