"""The way out: quick stop, disable voltage, NMT stop, and whatever else a loaded axis needs to stand.

Whatever fails in one step, the next ones are still taken. A loaded axis is held once it was seen to stand;
one that is not gets the next means at once: its brake, position mode, and then the drive's quick stop from
there.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from invid.errors import BusError
from invid.numerics.arrays import Bool, Float64
from invid.sweep.falling import Fall, Kind
from invid.sweep.loads import CONFIRM_S, LOAD_SHARE
from invid.sweep.ports import Sample
from invid.sweep.shortfall import HeldTorque
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402 import states
from invid_drivers.cia402.link import NMT_PRE_OPERATIONAL, NMT_STOP
from invid_drivers.cia402.standing.moving_cell import STOPPING, UNSEEN, MovingCell
from invid_drivers.cia402.standing.runaway import RunawayGuard
from invid_drivers.cia402.standing.standstill import tolerances
from invid_drivers.cia402.standing.stop_test import BRAKE_S, RESUME_S, SUPPORT_S, await_support
from invid_drivers.cia402.states import DriveState, state_of

QUICK_STOP_S = 1.0
"""Longest quick stop before the voltage is taken away regardless, where the drive's ramp is not longer."""
LONGEST_RAMP_S = 10.0
"""However gentle a drive's ramp is: an axis that is still moving then is let go, or held."""
RAMP_MARGIN = 1.25
"""On the time of a ramp from the speed limit: the axis may be faster, the drive settles at its end."""
WEIGHINGS = 3
"""An axis weighs nothing that showed no load once: those that were just let go swing on for a while."""
WEIGHED_SHARE = 0.5
"""Of the samples by which an axis is weighed must have come."""
DEAF_S = 0.2
"""A drive that is still enabled so long after quick stop does not hear its controlword (drives take it up in
a few cycles). NMT stop, which it may hear, has it stop by its abort option."""
BRAKE_MARGIN = 2.0
"""On the time and the way that a brake was seen to take."""
DRIVEN_SHARE = 0.8
"""Of the torque against its motion: a load that all its torque does not hold, and that is faster, weighs
1.8 times it."""
BRAKE_DROP = 0.02
"""Of the window: a brake that lets an axis go further does not hold it."""
DISABLE_S = 0.2
BY_SDO_S = 5.0
"""For all drives together that their TPDOs did not show off: they are asked, and told, by SDO."""
CATCHING_S = SUPPORT_S + 4 * RESUME_S + 2 * BRAKE_S
"""For axes that are caught, and held until they are supported, and for brakes to be seen."""
MOVING_S = LONGEST_RAMP_S + CATCHING_S + (1 + WEIGHINGS) * DISABLE_S + WEIGHINGS * CONFIRM_S
"""No step of the way out goes on in the cycle beyond this."""
WAY_OUT_S = MOVING_S + BY_SDO_S
"""Longest way out."""
STATE_POLL_S = 0.005
"""Between two questions for the statusword by SDO, on the way out."""

_RAMPING = (DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION_ACTIVE)


@dataclass(frozen=True)
class Loads:
    """What the axes of a cell carry, and by what that may be held.

    ``stays``: axes that their drives go on holding in quick stop active; ``braked``: loaded ones whose
    brakes do; ``doubted``: axes that stay only because nobody knows whether they are loaded; ``catchable``:
    those whose drives have position mode; ``falls`` those that were seen to fall or be driven, ``blind``
    those whose encoder is dead.
    """

    stays: Sequence[bool]
    braked: Collection[int] = ()
    doubted: Collection[int] = ()
    catchable: Collection[int] = ()
    falls: Mapping[int, Fall] = field(default_factory=dict)
    blind: Collection[int] = ()
    brake_s: Mapping[int, float] = field(default_factory=dict)
    brake_drop: Mapping[int, float] = field(default_factory=dict)
    """Seconds that brakes were seen to take, and how far their axes went meanwhile [rad or m]."""
    weights: Mapping[int, float] = field(default_factory=dict)
    """Torque that holds each loaded axis [N·m or N]."""


class WayOut:
    """One stop of the drives of a cell; made anew for each."""

    def __init__(
        self,
        cell: MovingCell,
        loads: Loads,
        ramp_s: float = 0.0,
        weigh: Callable[[Collection[int], Float64, Bool], Collection[int]] | None = None,
    ) -> None:
        """``ramp_s``: longest that a drive's quick stop takes, where that is known.

        ``weigh``: which of the doubted axes carry nothing, by torque and freshness (n, M) while their
        drives hold them.
        """
        self._cell = cell
        self._config = cell.config
        self._link = cell.link
        self._drives = cell.drives
        self._cycle = cell.cycle
        self._exchange = cell.exchange
        self._stays = list(loads.stays)
        self._fell: set[int] = set(loads.falls)
        self._blind = set(loads.blind)
        """What these show is no standing."""
        self._brake_s, self._brake_drop = loads.brake_s, loads.brake_drop
        self._still = tolerances(cell.config, cell.resolution)
        self._to_catch: set[int] = set()
        self.unheld: set[int] = set()
        """Loaded axes that were not seen to stand at the end."""
        self.failed_brakes: set[int] = set()
        self.caught: set[int] = set()
        """Axes that were held again, in position mode, after their drive or brake had let go."""
        self._braked = set(loads.braked)
        self._catchable = set(loads.catchable)
        has_brake = {i for i, a in enumerate(cell.config.axes) if a.brake == "drive"}
        self._brakes = has_brake & ({i for i, stays in enumerate(self._stays) if stays} | self._braked)
        """Brakes that loaded axes have left."""
        doubtful = {*loads.falls, *loads.blind}
        self._cut = {i for i in doubtful if i in self._brakes or not self._stays[i]}
        self._cut |= {i for i, fall in loads.falls.items() if self._is_driven(i, fall)}
        self._full = {i: fall for i, fall in loads.falls.items() if fall.at_limit}
        self.too_heavy = set(self._full) - self._cut
        """Axes that all their torque did not hold, and that fall faster without it."""
        for i in self._cut:
            self._to_brake(i)
        self._doubted, self._weigh = tuple(i for i in loads.doubted if i not in self._cut), weigh
        self._standstill, self._falling = cell.standstill(), cell.falling()
        self._guard = RunawayGuard(cell.config, cell.resolution)
        self._weights = dict(loads.weights)
        self._held_torque = HeldTorque(cell.rated, cell.resolution, cell.config.bus.cycle_s)
        self._given_up: set[int] = set()
        self._deaf: set[int] = set()
        self._began: float | None = None
        self._off_at: list[float] = []
        self._quick_stop_s = min(max(QUICK_STOP_S, RAMP_MARGIN * ramp_s), LONGEST_RAMP_S)
        self._ends = math.inf
        self._told: set[int] = set()

    def take(self) -> tuple[str, ...]:
        """Quick stop, disable voltage, NMT stop; the axes that were not seen to switch off. Never raises."""
        began = self._link.clock.now()
        self._ends = began + MOVING_S
        self._cycle.leave()
        self._tell({i for i in self._fell | self._blind if self._is_loaded(i)})
        with contextlib.suppress(Exception):
            self._cycle.control[:] = [states.QUICK_STOP] * len(self._drives)
            for i in self._cut:
                self._cycle.control[i] = states.DISABLE_VOLTAGE
            self._drive_to(self._quick_stop_s, self._at_rest)
        with contextlib.suppress(Exception):
            self._catch()
        self._disable()
        with contextlib.suppress(Exception):
            self._see_without()
        with contextlib.suppress(Exception):
            self._see_brakes()
        for _ in range(WEIGHINGS):
            if self._weigh is None or not any(self._stays[i] for i in self._doubted):
                break
            with contextlib.suppress(Exception):
                self._weigh_doubted(self._weigh)
            self._disable()
        self.unheld |= {
            i
            for i, stays in enumerate(self._stays)
            if stays and (i in self._blind or not self._standstill.stands(i))
        }
        unsure = [i for i in range(len(self._drives)) if self._may_disable(i) and self._may_be_on(i)]
        deaf = {i for i in unsure if self._disobeys(i)} | self._deaf
        on = [self._drives[i].name for i in sorted(self._deaf.difference(unsure))]
        self._link.until = self._link.clock.now() + BY_SDO_S
        for i in unsure:
            off = False
            with contextlib.suppress(Exception):
                off = self._switch_off_by_sdo(i, began + self._quick_stop_s)
            if not off or i in deaf:
                on.append(self._drives[i].name)
        for i, drive in enumerate(self._drives):
            if self._may_disable(i):
                with contextlib.suppress(Exception):
                    self._link.nmt(NMT_STOP, drive.node_id)
        return tuple(on)

    def _tell(self, axes: Collection[int] = ()) -> None:
        """Say at once what is done, and which loads a person must support: it may last two minutes."""
        self._told.update(axes)
        names = ", ".join(self._drives[i].name for i in sorted(self._told))
        with contextlib.suppress(Exception):  # whoever listens may have gone
            self._cell.tell(UNSEEN.format(names) if names else STOPPING)

    # --- loads ---------------------------------------------------------------------------------
    def _see_brakes(self) -> None:
        """See that each axis that is off and loaded stands on its brake; one that does not is caught."""
        axes = sorted(self._braked)
        if not axes:
            return
        waits = [BRAKE_MARGIN * self._brake_s.get(i, BRAKE_S / 4) for i in axes if i in self._fell]
        self._drive_to(max(waits, default=0.0), lambda sample: False)
        for i in axes:
            self._standstill.forget(i)
        sample = self._exchange(self._cycle.support)
        start, end = list(sample.position if waits else self._off_at), min(sample.time + BRAKE_S, self._ends)
        while not self._standstill.all(sample, axes) and sample.time < end:
            moved = {i for i in axes if abs(sample.position[i] - start[i]) > self._usual_drop(i)}
            if moved & self._catchable - self._fell:
                break
            sample = self._exchange(self._cycle.support)
            self._guard.faster(sample)
            self._lose_sight(self._guard.leapt)
        self.failed_brakes = {i for i in axes if not self._standstill.stands(i)}
        if self.failed_brakes:
            self._tell(self.failed_brakes)
        # a drive that was seen not to hold an axis is not given it again
        self._to_catch = self.failed_brakes & self._catchable - self._fell
        self.unheld |= self.failed_brakes - self._to_catch
        self._catch()

    def _usual_drop(self, axis: int) -> float:
        seen = self._brake_drop.get(axis)
        most = self._most_drop(axis)
        return (
            most if seen is None or axis in self._fell else min(most, BRAKE_MARGIN * seen + self._still[axis])
        )

    def _is_loaded(self, axis: int) -> bool:
        return self._stays[axis] or axis in self._braked

    def _most_drop(self, axis: int) -> float:
        return BRAKE_DROP * self._config.axes[axis].limits.position

    def _catch(self) -> None:
        """Hold axes that were let go in position mode, then by a quick stop from there.

        Where that lets them go again they are held in position mode until they are supported.
        """
        axes, self._to_catch = sorted(self._to_catch), set()
        if not axes:
            return
        for i in axes:
            self._stays[i] = True
            self._weights.pop(i, None)  # it may be supported by then
        self._catchable.difference_update(axes)
        held = self._hold(axes)
        self.caught.update(held)
        self._stop_again(axes)
        again = [i for i in held if not self._standstill.stands(i)]
        for i in self._hold(again):
            least, most = LOAD_SHARE * self._cell.rated[i], self._most_drop(i)
            await_support(lambda: self._exchange(self._cycle.support), i, least, most, self._ends)
        self._stop_again(again)

    def _hold(self, axes: Sequence[int]) -> list[int]:
        """Enable axes with the torque of their loads and then in position mode; those that were seen to
        stand so."""
        for i in axes:
            self._standstill.forget(i)
            self._cell.begin_to_hold(i)
        falling = self._cell.falling()
        sample = self._exchange(self._cycle.support)
        end = min(sample.time + RESUME_S, self._ends)
        left = set(axes)
        while left and sample.time < end:
            there = [self._cell.step_to_enabled(i, sample) for i in axes]
            if all(there) and not self._cycle.changing and self._standstill.all(sample, sorted(left)):
                break
            left.difference_update(falling.check(sample, left, _is_enabled))
            sample = self._exchange(self._cycle.support)
        return [i for i in axes if self._standstill.stands(i)]

    def _stop_again(self, axes: Sequence[int]) -> None:
        for i in axes:
            self._cycle.control[i] = states.QUICK_STOP
            self._standstill.forget(i)
        if axes:
            self._falling.forget()
            self._fell.difference_update(axes)
            self._drive_to(self._quick_stop_s, lambda s: self._at_rest(s) or not self._fell.isdisjoint(axes))

    def _next_means(self, sample: Sample) -> None:
        """What was to hold an axis does not: its brake is next, then position mode; what is driven is cut
        off."""
        loaded = [i for i in range(len(self._stays)) if self._is_loaded(i) and i not in self._given_up]
        for i, fall in self._falling.check(sample, loaded, _is_energised).items():
            self._fell.add(i)
            self._tell({i})
            if i in self._brakes or self._is_driven(i, fall):
                self._to_brake(i)
            elif i in self._catchable and not fall.at_limit:
                self._to_catch.add(i)

    def _is_driven(self, axis: int, fall: Fall) -> bool:
        """Whether its own drive does it: seen, or what all its torque does not slow down is no load of that
        mass.

        Of a mass that nobody stated both may be true. What is driven does more harm than what falls: it is
        cut off.
        """
        if fall.kind is Kind.DRIVEN or not fall.at_limit:
            return fall.kind is Kind.DRIVEN
        mass = self._config.axes[axis].inertia
        return mass is None or mass * fall.acceleration > DRIVEN_SHARE * abs(fall.torque)

    def _to_brake(self, axis: int) -> None:
        """Take the voltage away from an axis that its drive does not hold; what brake it has is seen to
        hold it."""
        if axis in self._brakes:
            self._brakes.discard(axis)
            self._braked.add(axis)
        elif self._stays[axis]:
            self.unheld.add(axis)
        self._catchable.discard(axis)
        self._stays[axis] = False
        self._cycle.control[axis] = states.DISABLE_VOLTAGE

    def _disable(self) -> None:
        for i in range(len(self._drives)):
            if self._may_disable(i):
                self._cycle.control[i] = states.DISABLE_VOLTAGE
        self._off_at = list(self._cycle.sample.position)
        with contextlib.suppress(Exception):
            self._drive_to(DISABLE_S, self._disabled)

    def _see_without(self) -> None:
        """Tell a load beyond the limit from a wrong sign, once the torque is gone: the load gets faster."""
        looked = sorted(set(self._full) & self._cut - self._braked)
        falling, sample = self._cell.falling(), self._cycle.sample
        end = sample.time + DISABLE_S
        while looked and sample.time < end:
            sample = self._exchange(self._cycle.support)
            for i, fall in falling.check(sample, looked).items():
                if fall.acceleration > self._full[i].acceleration:
                    self.too_heavy.add(i)
                looked.remove(i)

    def _weigh_doubted(self, weigh: Callable[[Collection[int], Float64, Bool], Collection[int]]) -> None:
        """Axes that carry nothing need not stay under power because a stop came before that was known."""
        axes = [i for i in self._doubted if self._stays[i]]
        torque: list[list[float]] = []
        fresh: list[list[bool]] = []
        steady = [True] * len(self._drives)

        def seen(sample: Sample) -> bool:
            torque.append(list(sample.torque))
            fresh.append(list(sample.fresh))
            self._standstill.all(sample, axes)
            for i in axes:
                held = state_of(sample.status[i]) is DriveState.QUICK_STOP_ACTIVE
                steady[i] = steady[i] and (not sample.fresh[i] or (held and self._standstill.stands(i)))
            return False

        if not all(self._standstill.stands(i) for i in axes):
            return
        self._drive_to(CONFIRM_S, seen)
        came = np.array(fresh)
        told = [i for i in axes if steady[i] and came[:, i].mean() > WEIGHED_SHARE]
        for i in weigh(told, np.array(torque), came):
            self._stays[i] = False

    def _may_be_on(self, axis: int) -> bool:
        """By its last TPDO: one that has not come, or came late, says nothing."""
        return not self._cycle.sample.fresh[axis] or states.is_energised(
            state_of(self._cycle.sample.status[axis])
        )

    def _disobeys(self, axis: int) -> bool:
        """Still enabled after quick stop and disable voltage: if it is off a little later, that was its own
        watch over RPDOs or heartbeat, and a person must know."""
        sample = self._cycle.sample
        return sample.fresh[axis] and state_of(sample.status[axis]) is DriveState.OPERATION_ENABLED

    def _switch_off_by_sdo(self, axis: int, ramp_ends: float) -> bool:
        """Ask a drive whose TPDOs did not show it off, switch it off where it is not; whether it is off.

        TPDOs that come late (a busy computer) or not at all do not say that SDO is dead too. A drive that
        does not answer is told to switch off all the same: it may hear.
        """
        drive, clock = self._drives[axis], self._link.clock
        if axis in self._given_up:
            self._link.nmt(NMT_PRE_OPERATIONAL, drive.node_id)  # NMT stopped, it would not answer
        state = drive.quiet_state()
        if state is None:
            drive.shout(od.CONTROLWORD, states.DISABLE_VOLTAGE)
            return False
        while state in _RAMPING and clock.now() < min(ramp_ends, self._link.until):
            self._link.wait(STATE_POLL_S)
            state = drive.quiet_state()
        if state is None or not states.is_energised(state):
            return state is not None
        drive.quiet_command(od.CONTROLWORD, states.DISABLE_VOLTAGE)
        end = clock.now() + DISABLE_S
        while (state := drive.quiet_state()) is not None and states.is_energised(state):
            if clock.now() >= end:
                return False
            self._link.wait(STATE_POLL_S)
        return state is not None

    def _may_disable(self, axis: int) -> bool:
        """An axis that would fall without torque stays in quick stop active, which holds it."""
        return not self._stays[axis]

    def _cut_runaways(self, sample: Sample) -> None:
        """An axis that a quick stop makes faster has a wrong sign somewhere: only cutting it off helps."""
        for i in self._guard.faster(sample):
            if self._may_disable(i):
                self._fell.add(i)
                self._to_brake(i)
        held = {i for i in self._weights if sample.fresh[i] and _is_energised(sample.status[i])}
        self._lose_sight({*self._guard.leapt, *self._held_torque.missing(sample, self._weights, held)})
        self._next_means(sample)
        if self._began is None:
            self._began = sample.time
        deaf = [
            i
            for i, status in enumerate(sample.status)
            if sample.time - self._began > DEAF_S
            and sample.fresh[i]
            and state_of(status) is DriveState.OPERATION_ENABLED
            and self._cycle.control[i] in (states.QUICK_STOP, states.DISABLE_VOLTAGE)
        ]
        self._deaf.update(deaf)
        for i in (*self._guard.silent(sample), *deaf):
            # It may hear NMT though its PDOs are lost; its abort option (0x6007) is a quick stop.
            if i not in self._given_up:
                self._given_up.add(i)
                self._link.nmt(NMT_STOP, self._drives[i].node_id)

    def _lose_sight(self, axes: Collection[int]) -> None:
        """No loop that a dead encoder closes holds: what has a brake or carries nothing is cut off."""
        if not self._blind.issuperset(axes):
            self._tell({i for i in axes if self._is_loaded(i)})
        self._blind.update(axes)
        self._catchable.difference_update(axes)
        for i in axes:
            if i in self._brakes or self._may_disable(i):
                self._to_brake(i)

    def _drive_to(self, seconds: float, reached: Callable[[Sample], bool]) -> None:
        end = min(self._link.clock.now() + seconds, self._ends)
        while self._link.clock.now() < end:
            try:
                sample = self._exchange(self._cycle.support)
            except BusError:  # a queue that is full has room again
                self._link.wait(self._config.bus.cycle_s)
                continue
            self._cut_runaways(sample)
            if reached(sample) or self._to_catch:
                return

    def _at_rest(self, sample: Sample) -> bool:
        """Every drive that talks has left operation enabled and, where it stays energised, stands."""
        staying = [
            i
            for i, status in enumerate(sample.status)
            if i not in self._given_up
            and state_of(status) is DriveState.QUICK_STOP_ACTIVE
            and self._is_loaded(i)
        ]
        if not self._standstill.all(sample, staying):
            return False
        for i, status in enumerate(sample.status):
            if i in self._given_up:
                continue
            if not sample.fresh[i]:
                return False
            match state_of(status):
                case DriveState.OPERATION_ENABLED | DriveState.FAULT_REACTION_ACTIVE:
                    return False
                case DriveState.QUICK_STOP_ACTIVE:
                    if not self._is_loaded(i):
                        return False  # option 2: the drive switches itself off when the ramp has ended
                case _:
                    pass
        return True

    def _disabled(self, sample: Sample) -> bool:
        return all(
            sample.fresh[i] and (not self._may_disable(i) or not states.is_energised(state_of(s)))
            for i, s in enumerate(sample.status)
        )


def _is_energised(status: int) -> bool:
    return states.is_energised(state_of(status))


def _is_enabled(status: int) -> bool:
    return state_of(status) is DriveState.OPERATION_ENABLED
