"""The way out: quick stop, disable voltage, NMT stop.

Whatever fails in one step, the next ones are still taken.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Sequence

import numpy as np

from invid.errors import BusError
from invid.numerics.arrays import Bool, Float64
from invid.sweep.loads import CONFIRM_S
from invid.sweep.ports import Sample
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402 import states
from invid_drivers.cia402.link import NMT_PRE_OPERATIONAL, NMT_STOP
from invid_drivers.cia402.moving_cell import MovingCell
from invid_drivers.cia402.runaway import RunawayGuard
from invid_drivers.cia402.standstill import Standstill, tolerances
from invid_drivers.cia402.states import DriveState, state_of

QUICK_STOP_S = 1.0
"""Longest quick stop before the voltage is taken away regardless, where the drive's ramp is not longer."""
LONGEST_RAMP_S = 10.0
"""However gentle a drive's ramp is: an axis that is still moving then is let go, or held."""
RAMP_MARGIN = 1.25
"""On the time of a ramp from the speed limit: the axis may be faster, the drive settles at its end."""
STILL_SHARE = 0.002
"""An axis that its drive goes on holding stands: share of its window in a tenth of a second."""
WEIGHINGS = 3
"""An axis weighs nothing that showed no load once: those that were just let go swing on for a while."""
WEIGHED_SHARE = 0.5
"""Of the samples by which an axis is weighed must have come."""
DEAF_S = 0.2
"""A drive that is still enabled so long after quick stop does not hear its controlword (drives take it up in
a few cycles). NMT stop, which it may hear, has it stop by its abort option."""
DISABLE_S = 0.2
BY_SDO_S = 5.0
"""For all drives together that their TPDOs did not show off: they are asked, and told, by SDO."""
WAY_OUT_S = LONGEST_RAMP_S + (1 + WEIGHINGS) * DISABLE_S + WEIGHINGS * CONFIRM_S + BY_SDO_S
"""Longest way out."""
STATE_POLL_S = 0.005
"""Between two questions for the statusword by SDO, on the way out."""

_RAMPING = (DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION_ACTIVE)


class WayOut:
    """One stop of the drives of a cell; made anew for each."""

    def __init__(
        self,
        cell: MovingCell,
        stays: Sequence[bool],
        ramp_s: float = 0.0,
        doubted: Collection[int] = (),
        opposed: Collection[int] = (),
        weigh: Callable[[Collection[int], Float64, Bool], Collection[int]] | None = None,
    ) -> None:
        """``stays``: axes that their drives go on holding in quick stop active.

        ``ramp_s``: longest that a drive's quick stop takes, where that is known; ``doubted``: axes that stay
        only because nobody knows whether they are loaded, and ``weigh``: which of these carry nothing, by
        torque and freshness (n, M) while their drives hold them. ``opposed``: axes that their drives drive,
        which are cut off at once.
        """
        self._config = cell.config
        self._link = cell.link
        self._drives = cell.drives
        self._cycle = cell.cycle
        self._exchange = cell.exchange
        self._stays = list(stays)
        for i in opposed:
            self._stays[i] = False
        self._opposed = tuple(opposed)
        self._doubted, self._weigh = tuple(i for i in doubted if i not in opposed), weigh
        self._standstill = Standstill(tolerances(cell.config, cell.resolution, STILL_SHARE))
        self._guard = RunawayGuard(cell.config, self._stays, cell.resolution, cell.permitted)
        self._given_up: set[int] = set()
        self._deaf: set[int] = set()
        self._began: float | None = None
        self._quick_stop_s = min(max(QUICK_STOP_S, RAMP_MARGIN * ramp_s), LONGEST_RAMP_S)

    def take(self) -> tuple[str, ...]:
        """Quick stop, disable voltage, NMT stop; the axes that were not seen to switch off. Never raises."""
        began = self._link.clock.now()
        self._cycle.leaving = True
        with contextlib.suppress(Exception):
            self._cycle.control[:] = [states.QUICK_STOP] * len(self._drives)
            for i in self._opposed:
                self._cycle.control[i] = states.DISABLE_VOLTAGE
            self._drive_to(self._quick_stop_s, self._at_rest)
        self._disable()
        for _ in range(WEIGHINGS):
            if self._weigh is None or not any(self._stays[i] for i in self._doubted):
                break
            with contextlib.suppress(Exception):
                self._weigh_doubted(self._weigh)
            self._disable()
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

    def _disable(self) -> None:
        for i in range(len(self._drives)):
            if self._may_disable(i):
                self._cycle.control[i] = states.DISABLE_VOLTAGE
        with contextlib.suppress(Exception):
            self._drive_to(DISABLE_S, self._disabled)

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
            self._cycle.control[i] = states.DISABLE_VOLTAGE  # the one case in which a loaded axis is let go
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

    def _drive_to(self, seconds: float, reached: Callable[[Sample], bool]) -> None:
        zero = [0.0] * len(self._drives)
        end = self._link.clock.now() + seconds
        while self._link.clock.now() < end:
            try:
                sample = self._exchange(zero)
            except BusError:  # a queue that is full has room again
                self._link.wait(self._config.bus.cycle_s)
                continue
            self._cut_runaways(sample)
            if reached(sample):
                return

    def _at_rest(self, sample: Sample) -> bool:
        """Every drive that talks has left operation enabled and, where it stays energised, stands."""
        staying = [
            i
            for i, status in enumerate(sample.status)
            if i not in self._given_up and state_of(status) is DriveState.QUICK_STOP_ACTIVE and self._stays[i]
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
                    if self._may_disable(i):
                        return False  # option 2: the drive switches itself off when the ramp has ended
                case _:
                    pass
        return True

    def _disabled(self, sample: Sample) -> bool:
        return all(
            sample.fresh[i] and (not self._may_disable(i) or not states.is_energised(state_of(s)))
            for i, s in enumerate(sample.status)
        )
