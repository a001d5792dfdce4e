"""Move the axes: modes, cycles around the feedback, and the watch over them."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from invid.config import CellConfig
from invid.errors import SafetyStop
from invid.numerics.arrays import Bool, Float64
from invid.planning.hold_laws import (
    CATCHING_RATIO,
    CENTRING_RATIO,
    Gains,
    centring,
    following,
    least_damping,
    master_hold,
)
from invid.planning.model import Plan, PlannedExperiment
from invid.planning.phases import CATCH_HZ, SETTLE_S, highest_frequency
from invid.sweep.bounds import Statistics
from invid.sweep.cell import Cell
from invid.sweep.loads import CONFIRM_S, STEADY_S, Load, differing, judge_loads
from invid.sweep.moment import TRACE_S, Moment
from invid.sweep.ports import Loop, Mode, Procedure, Sample, Sink, Want, Wish
from invid.sweep.watch import Watch
from invid.wording.sentence import sentence

FADE_S = 0.1
"""A stop on request fades the torque out in this time before the quick stop."""
PROGRESS_S = 0.2
STILL_S, STILL_SHARE = 0.2, 0.01
"""An axis rests that keeps so long within this share of its window around its place, and within the same
share of the way on which its velocity limit would take it: so little is added to what it is shaken by."""
CATCH_SHARE, CATCH_LEAST_HZ = 0.5, 0.2
"""Bringing an axis back to rest takes no more than half of the announced torque, if a weak hold can do it."""


@dataclass
class Feedback:
    """Feedback that holds one axis in torque mode: gains, place and bias."""

    axis: int
    gains: Gains
    bias: float
    limit: float


@dataclass(frozen=True)
class RowSink:
    """Who takes the rows of a stretch of cycles, from ``first`` up to ``last``; ``is_logged``: its log has
    them, too."""

    sink: Sink
    first: int
    last: int
    is_logged: bool = False


@dataclass(frozen=True)
class Log:
    """Rows of one stretch of cycles; (n, M) but for the time."""

    demand: Float64
    torque: Float64
    position: Float64
    fresh: Bool
    """Where the row's torque and position came with its SYNC; elsewhere they are the last ones."""
    time: Float64
    """(n,) SYNC instants [s]."""


def joined(logs: Sequence[Log]) -> Log:
    """Return several stretches as one."""
    names = ("demand", "torque", "position", "fresh", "time")
    return Log(*(np.concatenate([getattr(log, name) for log in logs]) for name in names))


class Motion:
    """Motion of a cell's axes from the first cycle to the last; who makes one also calls the cell's
    ``stop``.
    """

    def __init__(
        self,
        plan: Plan,
        config: CellConfig,
        cell: Cell,
        stop: threading.Event | None,
        report: Callable[[float], None],
    ) -> None:
        self.plan, self.config, self.cell = plan, config, cell
        self.forecast = plan.forecast
        """What is announced now: before the trials by the plan, after them by what they measured."""
        self.stop, self.report = stop, report
        count = len(config.axes)
        self.count = count
        self._zero = [0.0] * count
        self.origin = [0.0] * count
        """Where each axis stood at the start [rad or m]."""
        self.bias = [0.0] * count
        """Torque that each axis needs at rest [N·m or N]."""
        self.loads: tuple[Load, ...] = ()
        """What each axis carries, as the torque at rest said."""
        self._last: list[float] = [0.0] * count
        self._last_time = [0.0] * count
        self._velocity = [0.0] * count
        self._demand = [0.0] * count
        self.feedback: list[Feedback] = []
        self._modes: list[Mode] = []
        self.inertia: dict[int, float] = {}
        """Rigid inertia of the axes that were tried [kg·m² or kg]."""
        self.phase = "enabling"
        self.experiment: PlannedExperiment | None = None
        """What is being tried or measured."""
        self.done_s = 0.0
        self._next_report = 0.0
        self._watch: Watch | None = None
        self.led: set[int] = set()
        """Axes that are or were shaken, in torque mode around their places."""
        self._rested: set[int] | None = None
        """Axes that rest, and have done nothing else since."""
        self._recorded = False
        self._recent: deque[tuple[float, tuple[float, ...], tuple[float, ...]]] = deque(
            maxlen=max(1, round(TRACE_S / plan.cycle_s))
        )

    @property
    def moment(self) -> Moment | None:
        """Return where the motion is and its last seconds; ``None`` before the first cycle of the watch."""
        if not self._recent:
            return None
        time, position, torque = (np.array(part) for part in zip(*self._recent, strict=True))
        e = self.experiment
        return Moment(
            axes=self.plan.axes,
            phase=self.phase,
            axis=self.plan.axes[e.excited[0]] if e is not None and len(e.excited) == 1 else None,
            time=time - time[-1],
            position=position - np.array(self.origin),
            torque=torque,
        )

    @property
    def statistics(self) -> Statistics:
        """Return the statistics so far."""
        return self._watch.bounds.statistics if self._watch is not None else Statistics()

    @property
    def place(self) -> list[float]:
        """Return where each axis was last seen [rad or m]."""
        return list(self._last)

    @property
    def watching(self) -> Watch:
        """Return the watch; SafetyStop before the start."""
        if self._watch is None:
            raise SafetyStop("the sweep watches nothing before it has started")
        return self._watch

    def by_offset(self, axis: int) -> bool:
        """Return whether torque is added to a loop that the axis's drive keeps closed, also in
        ``Mode.TORQUE``."""
        return self.cell.by_offset[axis]

    def permit(self, axis: int, velocity: float) -> None:
        """Set another limit for the velocity of one axis, from here on; never above what was announced."""
        axes = list(self.config.axes)
        limits = axes[axis].limits.model_copy(update={"velocity": velocity})
        axes[axis] = axes[axis].model_copy(update={"limits": limits})
        self.config = self.config.model_copy(update={"axes": axes})
        self.watching.bounds.permit(axis, velocity)

    def resting_modes(self) -> list[Mode]:
        """Return the mode of each axis at rest: held by its drive where it can."""
        return [Mode.HOLD if can else Mode.TORQUE for can in self.cell.can_hold]

    def start(self) -> Procedure[None]:
        """Enable, watch, settle where every axis stands, and see that what carries a load stays held."""
        cell = self.cell
        # A drive that can hold starts holding; the others start at zero torque.
        if not cell.can_hold or cell.bounds is None:
            raise SafetyStop("the cell was not checked before the sweep")
        if self.stop is not None and self.stop.is_set():
            raise SafetyStop(
                sentence("stopped on request before any drive was enabled; nothing was recorded yet"),
                code="asked",
            )
        self._modes, self._bounds = self.resting_modes(), cell.bounds
        for i, axis in enumerate(self.config.axes):
            self._bounds.permit(i, axis.limits.velocity)
        yield from cell.energise(self._modes)
        yield from self._begin()
        yield from self._settle(first=True)
        while (yield from cell.secure([load.loaded for load in self.loads])):
            yield from self._begin()
            yield from self._settle()

    def _wish(self, torque: Sequence[float]) -> Wish:
        return Wish([Want.HOLD if mode is Mode.HOLD else Want.LEAD for mode in self._modes], torque)

    def _begin(self) -> Procedure[None]:
        """Watch every axis; its feedback is around where it stands now."""
        bounds = self._bounds
        self._watch = Watch(bounds, cycle_s=self.plan.cycle_s)
        sample = yield self._wish(self._zero)
        self.origin = list(sample.position)
        self._last, self._last_time = list(sample.position), [sample.time] * self.count
        if bounds.origin is None:
            bounds.start(self.origin)
        bounds.count_anew()
        self.watching.held = set(range(self.count))

    def _settle(self, *, first: bool = False) -> Procedure[None]:
        """Measure the torque that each axis needs at rest, and so which are loaded.

        ``first``: nothing has moved yet, no stop test has let an axis swing.
        """
        self.phase = "settling"
        held = [mode is Mode.HOLD for mode in self._modes]
        rated = self.cell.rated_torque
        self.watching.bounds.resting = {i for i in range(self.count) if first and held[i]}
        self.watching.bounds.near = self.announced({i for i in range(self.count) if not first and held[i]})
        rows = yield from self.play(None, round(SETTLE_S / self.plan.cycle_s))
        self.watching.words.learn_rest()
        half = len(rows.torque) // 2
        self.loads = judge_loads(self.config, rows.torque[half:], rows.fresh[half:], held, rated)
        # a brake may open a second after its drive is enabled
        braked = any(a.brake == "drive" and a.gravity_loaded is not False for a in self.config.axes)
        if braked or any(load.loaded for load in self.loads):  # one must be sure of it, and of its torque
            done = self.done_s
            self.loads = yield from self._weigh(held, rated)
            if any(load.said for load in self.loads):  # a person who leans on it is no load
                self.loads = yield from self._weigh(held, rated)
            self.done_s = done  # no part of the plan
        self.watching.bounds.resting, self.watching.bounds.near = set(), {}
        weights = {i: load.torque for i, load in enumerate(self.loads) if load.loaded and held[i]}
        self.watching.bounds.weights = {i: w for i, w in weights.items() if np.isfinite(w)}
        for i, load in enumerate(self.loads):
            # What the drive needs to hold an axis is what it needs when the master takes over; only a
            # loaded axis is believed to need any, friction held at rest can be anything. A drive that is
            # shaken by its torque offset keeps its own loop, which holds it.
            known = held[i] and load.loaded and np.isfinite(load.torque) and not self.by_offset(i)
            self.bias[i] = load.torque if known else 0.0

    def _weigh(self, held: Sequence[bool], rated: Sequence[float]) -> Procedure[tuple[Load, ...]]:
        """Loads by the later of two stretches that agree; SafetyStop where none do for ``STEADY_S``."""
        before = None
        for _ in range(1 + round(STEADY_S / CONFIRM_S)):
            rows = yield from self.play(None, round(CONFIRM_S / self.plan.cycle_s))
            now = judge_loads(self.config, rows.torque, rows.fresh, held, rated)
            if before is not None and not differing(before, now, rated):
                return now
            last, before = before, now
        wrong = [self.config.axes[i].name for i in differing(last or now, now, rated)]
        raise SafetyStop(
            f"axis {', '.join(wrong)}: the torque that holds it at rest does not settle within {STEADY_S:g} "
            "s",
            way_out="somebody leans on it, its brake drags, or another axis swings: nothing was recorded yet",
            code="not_held",
            axes=wrong,
        )

    def announced(self, axes: set[int]) -> dict[int, tuple[float, float]]:
        """Where axes stood and how far they may go from there by what the whole run was announced.

        Before they are shaken healthy ones use at most 0.55 of it (436 axes of ``tests/machines/cells.py``).
        """
        return {i: (self.origin[i], self.plan.forecast[i].travel) for i in axes}

    # --- one cycle and many --------------------------------------------------------------------
    def play(
        self,
        torque: Float64 | None,
        cycles: int,
        *,
        reference: Float64 | None = None,
        scale: float = 1.0,
        recording: RowSink | None = None,
    ) -> Procedure[Log]:
        """Run ``cycles`` cycles around the feedback; the log has rows where they are not recorded alone.

        ``torque`` and ``reference`` are (n, M); their last row stands for every later one. Rows become
        lists one at a time: half an hour at once would stall the cycle and take gigabytes.
        """
        watch, stop, recent = self.watching, self.stop, self._recent
        cycle = self.plan.cycle_s
        feedback, origin, velocity = self.feedback, self.origin, self._velocity
        demand = self._demand
        watch.bounds.obedience.paused = reference is not None
        first, last = (0, 0) if recording is None else (recording.first, recording.last)
        logged = recording is None or recording.is_logged
        kept: tuple[list[list[float]], ...] = ([], [], [], [])
        instants: list[float] = []
        start: int | None = None
        fading = 0
        fade = max(1, round(FADE_S / cycle))
        k = 0
        self._rested = None
        while k < cycles:
            excitation = self._zero if torque is None else torque[min(k, len(torque) - 1)].tolist()
            path = before = None
            if reference is not None:
                path = reference[min(k, len(reference) - 1)].tolist()
                before = reference[min(max(k - 1, 0), len(reference) - 1)].tolist()
            gain = scale
            if fading:
                gain *= 1.0 - fading / fade
            for f in feedback:
                i = f.axis
                away, speed = self._last[i] - origin[i], velocity[i]
                if path is not None and before is not None:
                    away -= path[i]
                    speed -= (path[i] - before[i]) / cycle
                value = f.bias + gain * excitation[i] - f.gains.stiffness * away - f.gains.damping * speed
                demand[i] = f.limit if value > f.limit else -f.limit if value < -f.limit else value
            sample = yield self._wish(demand)
            if start is None:
                start = sample.slot
            k = sample.slot - start
            recent.append((sample.time, tuple(sample.position), tuple(sample.torque)))
            watch.check(sample)
            self._differentiate(sample)
            if recording is not None and first <= k < last:
                self._recorded = True
                recording.sink.row(sample, demand)
            if logged:
                kept[0].append(list(demand))
                kept[1].append(list(sample.torque))
                kept[2].append(list(sample.position))
                kept[3].append(list(sample.fresh))
                instants.append(sample.time)
            k += 1
            if fading:
                fading += 1
                if fading > fade:
                    so_far = (
                        sentence("the recording so far is kept")
                        if self._recorded
                        else sentence("nothing was recorded yet")
                    )
                    raise SafetyStop(sentence("stopped on request; {so_far}", so_far=so_far), code="asked")
            elif stop is not None and stop.is_set():
                fading = 1
                cycles = max(cycles, k + fade + 1)
            if sample.time >= self._next_report:
                self._next_report = sample.time + PROGRESS_S
                self.report(k * cycle)
        self.done_s += cycles * cycle
        demands, torques, positions, came = (np.asarray(part) for part in kept)
        return Log(demands, torques, positions, came.astype(bool), np.asarray(instants))

    def learn(self, experiment: PlannedExperiment, kept: Log) -> None:
        """How shaken axes follow their torque, from rows in which they did."""
        if experiment.reference is not None:
            return
        obedience = self.watching.bounds.obedience
        fastest = highest_frequency([experiment])
        for i in experiment.excited:
            columns = kept.time, kept.demand[:, i], kept.position[:, i], kept.fresh[:, i]
            obedience.learn(i, *columns, fastest)

    def _differentiate(self, sample: Sample) -> None:
        last, before, velocity, position = self._last, self._last_time, self._velocity, sample.position
        for i, fresh in enumerate(sample.fresh):
            if fresh and (dt := sample.time - before[i]) > 0:
                velocity[i] = (position[i] - last[i]) / dt
                last[i], before[i] = position[i], sample.time

    def change(self, modes: Sequence[Mode], feedback: list[Feedback]) -> Procedure[None]:
        """Change modes and feedback, while the cycle goes on. Torque starts at the bias, as the hold left it.

        Until every drive is in its mode, an axis that its drive shall hold keeps the feedback it had, and one
        that comes into torque mode has its own already: torque closes its loop whenever the drive takes it.
        """
        demand = list(self._zero)
        for f in feedback:
            demand[f.axis] = f.bias
        self.led = set()
        if list(modes) != self._modes:
            coming = {f.axis for f in feedback}
            self.feedback = [*feedback, *(f for f in self.feedback if f.axis not in coming)]
            self.watching.words.pause()
            self._modes = list(modes)
            done = self.done_s
            self.watching.bounds.unmoved.begin({})  # a drive that is not in its mode yet holds its axis
            yield from self.play(None, 1)
            while self.cell.changing:
                yield from self.play(None, 1)
            self.done_s = done  # no part of the plan
            self.watching.halting.pause()
            self.watching.words.resume()
        self.feedback, self._demand = feedback, demand
        loops: list[Loop | None] = [None] * self.count
        for f in feedback:
            loops[f.axis] = Loop(f.bias, f.gains.damping)
        self.cell.set_loops(loops)
        masses = {f.axis: (self.inertia.get(f.axis, math.inf), f.bias) for f in feedback}
        self.watching.bounds.unmoved.begin({i: m for i, m in masses.items() if not self.by_offset(i)})
        self.watching.settle()

    def centre(self, excited: set[int], *, lowest: float, path: bool = False) -> Procedure[None]:
        """Put excited axes in torque mode around their place, hold the others as configured."""
        cycle = self.plan.cycle_s
        modes: list[Mode] = []
        feedback = []
        for i, settings in enumerate(self.config.axes):
            limit = settings.limits.torque
            if i in excited:
                inertia = self.inertia.get(i) or self.plan.inertia[i] or 0.0
                ratio = CATCHING_RATIO if lowest == CATCH_HZ else CENTRING_RATIO
                gains = following(inertia, cycle) if path else centring(inertia, lowest, cycle, ratio)
                if self.by_offset(i):
                    gains = Gains(0.0, 0.0)  # its drive holds it all the time
                modes.append(Mode.TORQUE)
                feedback.append(Feedback(i, gains, self.bias[i], limit))
                continue
            held = self._hold_gains(i)
            modes.append(Mode.HOLD if held is None else Mode.TORQUE)
            if held is not None:
                feedback.append(Feedback(i, held, self.bias[i], limit))
        yield from self.change(modes, feedback)
        self.watching.bounds.obedience.shake(excited)
        self.led = set(excited)
        self.watching.held = set(range(self.count)) - excited

    def rest(self, excited: set[int]) -> Procedure[Log]:
        """Bring excited axes back to their places and to rest, hold the others as configured.

        Those that were excited before come to rest first: a stiff hold that takes over an axis on its way
        stops it with all its torque. Axes that rest already need no time for it.
        """
        if self._rested == excited:
            return (yield from self.play(None, 0))
        if self.led and self.led != excited:
            yield from self.rest(set(self.led))
        yield from self.centre(excited, lowest=CATCH_HZ)
        cycle = self.plan.cycle_s
        for f in self.feedback:
            i = f.axis
            if i not in excited:
                continue
            # An axis that is far away or fast is brought back more gently.
            away, speed = abs(self._last[i] - self.origin[i]), abs(self._velocity[i])
            lowest = CATCH_HZ
            if self.by_offset(i):
                continue
            most = CATCH_SHARE * self.forecast[i].peak_torque
            while f.gains.stiffness * away + f.gains.damping * speed > most and lowest > CATCH_LEAST_HZ:
                lowest /= 2
                inertia = self.inertia.get(i) or self.plan.inertia[i] or 0.0
                f.gains = centring(inertia, lowest, cycle, CATCHING_RATIO)
        log = yield from self.until_still(excited, self.plan.rest_s)
        self._rested = set(excited)
        return log

    def until_still(self, axes: set[int], longest_s: float) -> Procedure[Log]:
        """Go on with the feedback, with axes of a model until they rest at their places, at most so long.

        What swings behind a motor that stands is known to be slow or not by a model only.
        """
        cycle = self.plan.cycle_s
        if any(self.plan.doublets[i] is None for i in axes):
            return (yield from self.play(None, round(longest_s / cycle)))
        left, part = round(longest_s / cycle), max(1, round(STILL_S / 2 / cycle))
        logs: list[Log] = []
        while left > 0:
            logs.append((yield from self.play(None, min(part, left))))
            left -= part
            if len(logs) > 1 and self._is_still(axes, joined(logs[-2:])):
                break
        return joined(logs)

    def _is_still(self, axes: set[int], log: Log) -> bool:
        for i in axes:
            limits = self.config.axes[i].limits
            away = log.position[:, i] - self.origin[i]
            if np.abs(away).max() > STILL_SHARE * limits.position:
                return False
            if np.ptp(away) > STILL_SHARE * STILL_S * limits.velocity:
                return False
        return True

    def stated_holds(self) -> list[float]:
        """Return the stiffness of the hold of every axis; NaN inside a drive, where nobody knows it."""
        gains = [float("nan")] * self.count
        for f in self.feedback:
            gains[f.axis] = float("nan") if self.by_offset(f.axis) else f.gains.stiffness
        return gains

    def _hold_gains(self, axis: int) -> Gains | None:
        """Gains of a held axis; ``None``: inside the drive."""
        settings = self.config.axes[axis]
        if self.by_offset(axis):
            return None
        held = master_hold(settings, self.plan.cycle_s)
        if held is not None:
            return held
        if self.cell.can_hold[axis]:
            return None
        # A drive without position mode is held by the master: half the torque limit at the window's edge.
        stiffness = 0.5 * settings.limits.torque / settings.limits.position
        return Gains(stiffness, max(least_damping(stiffness, self.plan.cycle_s), 0.1 * stiffness))
