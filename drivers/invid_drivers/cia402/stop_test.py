"""The stop test: at rest, load supported, each loaded axis is stopped as it may be later, and watched.

A brake is tried by taking the voltage away; a drive that must hold by itself, by a quick stop, by silence of
the master in quick stop active, by transition 16 back to operation, and by silence in operation. SYNC goes on
but in the silences, which are a master that has died.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from invid.errors import BusError, DriveError, SafetyStop
from invid.sweep.loads import LOAD_SHARE
from invid.sweep.ports import Mode, Sample, Severity
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402 import states
from invid_drivers.cia402.hold_memory import HoldMemory
from invid_drivers.cia402.holding import AxisHolding
from invid_drivers.cia402.link import NMT_START
from invid_drivers.cia402.mode_change import upload
from invid_drivers.cia402.moving_cell import MovingCell
from invid_drivers.cia402.standstill import Standstill, tolerances
from invid_drivers.cia402.states import DriveState, OperationMode, is_energised, state_of

HOLD_S = 0.4
"""Watched after a quick stop: longer than the ramp from rest, and than a drive takes to switch itself off."""
REST_S, BRAKE_S = 0.3, 2.0
"""A brake has closed when the axis has stood for so long; longest time for it."""
SETTLE_S = 2.0
"""What the axis did before has died away by then."""
RESUME_S = 3.0
"""Longest way back to operation enabled."""
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


class StopTest:
    """One test of the loaded axes of a cell that its drives hold."""

    def __init__(
        self,
        cell: MovingCell,
        holdings: Sequence[AxisHolding],
        memory: HoldMemory,
        cancelled: Callable[[], bool],
        rated: Sequence[float],
    ) -> None:
        """``rated`` torque of each axis [N·m or N]."""
        self._config, self._link, self._drives, self._cycle = cell.config, cell.link, cell.drives, cell.cycle
        self._holdings, self._memory = holdings, memory
        self._cell_exchange, self._cancelled = cell.exchange, cancelled
        self._rated = rated
        self._zero = [0.0] * len(cell.drives)
        self._still = tolerances(cell.config, cell.resolution, STILL_SHARE)

    def run(self) -> bool:
        """Test what was not seen yet; whether anything was tested. All axes are held again by their drives.

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
        """Wait until axes rest: one that moved before the test says nothing of its brake or drive."""
        standing, sample = Standstill(self._still), self._exchange()
        end = sample.time + SETTLE_S
        while not standing.all(sample, axes):
            if sample.time > end:
                moving = [self._name(i) for i in axes if not standing.stands(i)]
                raise SafetyStop(
                    f"axis {', '.join(moving)}: moves, though its drive is to hold it at rest (before the "
                    "stop test). Somebody moves it, its load is beyond the drive's torque limit, or a sign "
                    "is wrong in it",
                    axes=moving,
                )
            sample = self._exchange()

    # --- brakes --------------------------------------------------------------------------------
    def _try_brakes(self, axes: Sequence[int]) -> None:
        """Switch the drives off and measure when and how far each axis moved last."""
        sample = self._exchange()
        start, began = list(sample.position), sample.time
        place, moved_at = list(start), [began] * len(start)
        drop = [0.0] * len(start)
        for i in axes:
            self._cycle.control[i] = states.DISABLE_VOLTAGE
        while True:
            sample = self._exchange()
            for i in axes:
                if not sample.fresh[i]:
                    moved_at[i] = sample.time  # nobody knows
                    continue
                drop[i] = max(drop[i], abs(sample.position[i] - start[i]))
                if abs(sample.position[i] - place[i]) > self._still[i]:
                    place[i], moved_at[i] = sample.position[i], sample.time
            if all(sample.time - moved_at[i] > REST_S for i in axes):
                break
            if sample.time - began > BRAKE_S:
                falls = [self._name(i) for i in axes if sample.time - moved_at[i] <= REST_S]
                raise SafetyStop(
                    f"axis {', '.join(falls)}: its drive was switched off at rest, and {BRAKE_S:g} s later "
                    "no brake held it (stop test). Set brake: none, or see to the brake",
                    axes=falls,
                )
        for i in axes:
            delay = max(0.0, moved_at[i] - began)
            self._note(i, brake_s=delay, brake_drop=drop[i])
        self._enable(axes)

    # --- drives --------------------------------------------------------------------------------
    def _try_stop(self, axes: Sequence[int]) -> None:
        """Try quick stop, silence, back, silence, back; the other axes are off during the silences."""
        others = [i for i in range(len(self._drives)) if i not in axes]
        start = list(self._exchange().position)
        for i in axes:
            self._cycle.control[i] = states.QUICK_STOP
        self._watch(HOLD_S, axes, start, "after a quick stop")
        for i in others:
            self._cycle.control[i] = states.QUICK_STOP if self._holdings[i].stays else states.DISABLE_VOLTAGE
        self._watch(HOLD_S, axes, start, "after a quick stop")
        watched = [i for i in axes if self._holdings[i].watched]
        if watched:
            self._fall_silent(watched, start)
        self._resume(axes)
        if watched:
            self._fall_silent(watched, start)
            self._resume(axes)
        for i in axes:
            self._note(i, holds=True, resumes=True)
        self._enable(others)

    def _watch(self, seconds: float, axes: Sequence[int], start: Sequence[float], when: str) -> None:
        """Watch that each axis stays in quick stop active and in place; SafetyStop where one does not.

        Each is judged by an answer of its own after that time: one that was late says nothing about its hold.
        """
        sample = self._exchange()
        end = sample.time + seconds
        silent = set(axes)
        while silent and sample.time < end + ANSWER_S:
            sample = self._exchange()
            self._require_power(sample, axes, when)
            self._require_place(sample, axes, start, when)
            for i in silent.copy():
                if sample.time < end or not sample.fresh[i]:
                    continue
                silent.remove(i)
                state = state_of(sample.status[i])
                if state is not DriveState.QUICK_STOP_ACTIVE:
                    self._lets_go(i, f"{when} its drive is in {state.words}")
        if silent:
            names = [self._name(i) for i in sorted(silent)]
            raise BusError(
                f"axis {', '.join(names)}: no answer for {ANSWER_S:g} s {when}, in the stop test", axes=names
            )

    def _require_power(self, sample: Sample, axes: Sequence[int], when: str) -> None:
        """Catch a drive that lets go in the cycle in which it does, before its load has got anywhere."""
        for i in axes:
            state = state_of(sample.status[i])
            if sample.fresh[i] and not is_energised(state):
                self._catch(i)
                self._lets_go(i, f"{when} its drive is in {state.words}")

    def _catch(self, axis: int) -> None:
        """Enable an axis again where it stood, and hold it until its load is seen to be supported.

        The sign of that is the torque that holds it falling to what an axis without load takes. Whoever does
        not support it in time has a load that nothing holds.
        """
        self._note(axis, holds=False)
        if not self._until_enabled([axis]):
            return
        sample = self._exchange()
        end, since = sample.time + SUPPORT_S, None
        while sample.time < end and (since is None or sample.time - since < SUPPORTED_S):
            if abs(sample.torque[axis]) > LOAD_SHARE * self._rated[axis]:
                since = None
            elif since is None:
                since = sample.time
            sample = self._exchange()

    def _require_place(self, sample: Sample, axes: Sequence[int], start: Sequence[float], when: str) -> None:
        for i in axes:
            moved = abs(sample.position[i] - start[i])
            if sample.fresh[i] and moved > max(self._holdings[i].most_drop, self._still[i]):
                self._lets_go(i, f"{when} it moved by {moved:.2g} {'m' if self._config.linear else 'rad'}")

    def _lets_go(self, axis: int, what: str) -> None:
        self._note(axis, holds=False)
        raise SafetyStop(
            f"axis {self._name(axis)}: it carries a load, and {what} (stop test at rest): its drive would "
            "let it fall. Use a brake that the drive closes (brake: drive), another drive, or unload the "
            "axis",
            axis=self._name(axis),
        )

    def _fall_silent(self, axes: Sequence[int], start: Sequence[float]) -> None:
        """Send nothing for as long as the drives' heartbeat watch is, and more; then look."""
        link = self._link
        link.beating = False
        watch = 3 * self._config.safety.heartbeat_s
        began = link.clock.now()
        try:
            while link.clock.now() < began + 1.5 * watch + SILENCE_S and not self._lost(axes):
                for i in axes:  # a question is no sign of life of a master
                    link.ask(self._drives[i].node_id, upload(od.STATUSWORD))
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
        link.wait(0.005)
        lost = self._lost(axes)
        if lost:
            self._cycle.restart_slots()
            for i in lost:
                self._catch(i)
            self._lets_go(lost[0], f"without its master for {watch:.2g} s at most its drive switched off")
        for i in axes:  # asked before it is commanded anything: what it did by itself
            state = self._state_of(i)
            if state is not DriveState.QUICK_STOP_ACTIVE:
                self._lets_go(i, f"without its master for {watch:.2g} s its drive is in {state.words}")
            self._cycle.control[i] = states.QUICK_STOP
        self._cycle.restart_slots()
        self._watch(HOLD_S / 2, axes, start, "without its master")

    def _lost(self, axes: Sequence[int]) -> list[int]:
        """Axes whose drives were last seen without power."""
        known = [self._link.gate.nodes[self._drives[i].node_id].state for i in axes]
        return [i for i, s in zip(axes, known, strict=True) if s is not None and not is_energised(s)]

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
        for i in axes:
            self._cycle.control[i] = states.ENABLE_OPERATION
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
                self._cycle.change(i, Mode.HOLD, OperationMode.CYCLIC_POSITION)
        while self._cycle.changing:
            self._exchange()

    def _until_enabled(self, axes: Sequence[int]) -> bool:
        sample = self._exchange()
        end = sample.time + RESUME_S
        while sample.time < end:
            found = [state_of(s) for s in sample.status]
            if all(sample.fresh[i] and found[i] is DriveState.OPERATION_ENABLED for i in axes):
                return True
            for i in axes:
                if sample.fresh[i] and found[i] is not DriveState.QUICK_STOP_ACTIVE:
                    self._cycle.control[i] = states.towards_enabled(found[i])
                elif sample.fresh[i]:
                    self._cycle.control[i] = states.ENABLE_OPERATION
            sample = self._exchange()
        return False

    # --- one cycle -----------------------------------------------------------------------------
    def _exchange(self) -> Sample:
        sample = self._cell_exchange(self._zero)
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
