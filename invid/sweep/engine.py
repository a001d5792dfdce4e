"""The sweep: runs a plan against ports. Whoever energises also stops, whatever happens in between."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from invid.arrays import Bool, Float64
from invid.config import CellConfig
from invid.errors import SafetyStop
from invid.excitation import doublet, ramped
from invid.plan.model import Plan, PlannedExperiment
from invid.recording.model import Kind
from invid.sweep import trials
from invid.sweep.holds import Gains, centring, following, least_damping, master_hold
from invid.sweep.ports import Cell, Mode, Sample, Sink
from invid.sweep.watch import AxisLimits, Statistics, Watch

SETTLE_S = 0.3
"""Held by the drives before anything else, to measure the torque that the holds need (gravity)."""
TRIAL_FIRST_S, TRIAL_LAST_S = 0.02, 1.28
"""Lengths of the doublets, doubled until the axis has moved enough."""
TRIAL_COUNTS, TRIAL_WINDOW = 50, 0.01
"""Enough is 50 encoder counts and 1 % of the position window: the slope is then good to a few per cent."""
TRIAL_MOST = 0.1
"""A trial ends when it has used a tenth of the position window."""
LATE_TRIALS = 20
"""Trials that say nothing because somebody was late, before the measurement gives up: seven seconds at least,
so that a few in which a computer is busy with something else do not end it; each trial is as small as the
others and the axis is caught after it. Empirical: a machine on which one SYNC in twenty comes late spoils one
doublet in three."""
CATCH_S = 0.3
"""For a weak hold of 1 Hz to catch what a trial left moving."""
LEAST_COUNTS = 5
"""Less than this after the longest doublet, and the axis did not move."""
NEAR_LIMIT = 0.8
"""The trial foretells the motion at full amplitude; beyond this share of a limit it is scaled down."""
TRIAL_PERIOD_S = 10.0
CLIMB_S = 4.0
"""Second step of the amplitude's trial, at the root of the first share: friction that hides motion at a
tenth of the amplitude hides less of it at a third."""
DECIDE_S, DECIDE_POLL_S = 60.0, 0.1
"""The axes are held this long while whoever ordered the measurement judges what is there."""
FADE_S = 0.1
"""A stop on request fades the torque out in this time before the quick stop."""
PROGRESS_S = 0.2


@dataclass(frozen=True)
class Progress:
    """Where a measurement is."""

    phase: str
    axis: str | None
    frequency: float | None
    """[Hz] where there is one."""
    fraction: float
    """0…1."""
    eta_s: float
    """Remaining robot time [s]."""


@dataclass(frozen=True)
class SweepResult:
    """Facts of a finished sweep."""

    scale: float
    """Factor applied to every torque of the plan; below 1 where a limit was near."""
    inertia: dict[str, float]
    """Rigid inertia of each excited axis as the trial saw it [kg·m² or kg]."""
    statistics: Statistics
    warnings: tuple[str, ...] = ()
    measured_s: float = 0.0


@dataclass
class _Feedback:
    """One axis in torque mode."""

    axis: int
    gains: Gains
    bias: float
    limit: float


@dataclass(frozen=True)
class _Log:
    """Rows of one stretch of cycles; (n, M) but for the time."""

    demand: Float64
    torque: Float64
    position: Float64
    fresh: Bool
    """Where the row's torque and position came with its SYNC; elsewhere they are the last ones."""
    time: Float64
    """(n,) SYNC instants [s]."""


@dataclass
class Sweep:
    """One run of one plan. ``run`` may be called once."""

    plan: Plan
    config: CellConfig
    cell: Cell
    sink: Sink
    progress: Callable[[Progress], None] | None = None
    stop: threading.Event | None = None
    warnings: list[str] = field(default_factory=list)
    go_on: Callable[[int], bool | None] | None = None
    """Asked after each experiment but the last, with its number: True next one, False enough, ``None`` not
    known yet (the axes are held, and it is asked again)."""

    def __post_init__(self) -> None:
        count = len(self.config.axes)
        self._count = count
        self._zero = [0.0] * count
        self._origin = [0.0] * count
        self._bias = [0.0] * count
        self._last: list[float] = [0.0] * count
        self._last_time = [0.0] * count
        self._velocity = [0.0] * count
        self._demand = [0.0] * count
        self._feedback: list[_Feedback] = []
        self._modes: list[Mode] = []
        self._inertia: dict[int, float] = {}
        self._scale = 1.0
        self._done_s = 0.0
        self._total_s = self.plan.duration_s + self._trial_s()
        self._next_report = 0.0
        self._phase = "enabling"
        self._now: PlannedExperiment | None = None
        self._watch: Watch | None = None
        self._must_move: set[int] = set()
        self._recorded = self._living = False

    def _trial_s(self) -> float:
        return 2.0 * len(self.plan.excited) + TRIAL_PERIOD_S + CLIMB_S + self.plan.rest_s

    # --- the run -------------------------------------------------------------------------------
    def run(self) -> SweepResult:
        """Enable, try, measure, stop.

        Raises
        ------
        SafetyStop, DriveError, BusError
            The drives are stopped by then; what the sink holds is what was measured so far.
        """
        self._report()
        for axis in self.config.axes:
            master_hold(axis, self.plan.cycle_s)  # refuses an unstable hold before anything is enabled
        try:
            self._start()
            for i in self.plan.excited:
                self._try_signs(i)
            self._try_amplitude()
            for number, experiment in enumerate(self.plan.experiments):
                self._experiment(experiment, number)
                if number + 1 < len(self.plan.experiments) and self._enough(number):
                    self._total_s = self._done_s
                    break
        finally:
            self.cell.stop()
        self._phase, self._done_s = "done", self._total_s
        self._report()
        return SweepResult(
            scale=self._scale,
            inertia={self.plan.axes[i]: m for i, m in self._inertia.items()},
            statistics=self._watching.statistics,
            warnings=tuple(self.warnings),
            measured_s=self._total_s,
        )

    @property
    def statistics(self) -> Statistics:
        """What was seen so far."""
        return self._watch.statistics if self._watch is not None else Statistics()

    @property
    def _watching(self) -> Watch:
        if self._watch is None:
            raise SafetyStop("the sweep watches nothing before it has started")
        return self._watch

    def _resting_modes(self) -> list[Mode]:
        return [Mode.HOLD if can else Mode.TORQUE for can in self.cell.can_hold]

    def _start(self) -> None:
        cell, config = self.cell, self.config
        # A drive that can hold starts holding; the others start at zero torque.
        if not cell.can_hold:
            raise SafetyStop("the cell was not checked before the sweep")
        if self.stop is not None and self.stop.is_set():
            raise SafetyStop("stopped on request before any drive was enabled; nothing was recorded yet")
        self._modes = self._resting_modes()
        cell.energise(self._modes)
        unit = "m" if config.linear else "rad"
        self._watch = Watch(
            [
                AxisLimits(
                    a.name,
                    a.limits.torque,
                    a.limits.position,
                    a.limits.velocity,
                    cell.resolution[i],
                    cell.rated_torque[i],
                    unit,
                    "N" if config.linear else "N·m",
                )
                for i, a in enumerate(config.axes)
            ],
            cycle_s=self.plan.cycle_s,
            missed_tpdos=config.safety.missed_tpdos,
            overrun_cycles=config.safety.overrun_cycles,
        )
        sample = cell.exchange(self._zero)
        self._origin = list(sample.position)
        self._last, self._last_time = list(sample.position), [sample.time] * self._count
        self._watching.start(self._origin)
        self._watching.held = set(range(self._count))
        self._phase = "settling"
        rows = self._play(None, round(SETTLE_S / self.plan.cycle_s), log=True)
        torque = rows.torque[len(rows.torque) // 2 :]
        for i, mode in enumerate(self._modes):
            # What the drive needs to hold an axis is what it needs when the master takes over; only a
            # gravity-loaded axis is believed to need any, friction held at rest can be anything.
            if mode is Mode.HOLD and config.axes[i].gravity_loaded:
                self._bias[i] = float(np.mean(torque[:, i]))

    # --- one cycle and many --------------------------------------------------------------------
    def _play(
        self,
        torque: Float64 | None,
        cycles: int,
        *,
        reference: Float64 | None = None,
        scale: float = 1.0,
        sink: Sink | None = None,
        rows: tuple[int, int] = (0, 0),
        log: bool = False,
    ) -> _Log:
        """Run ``cycles`` cycles around the feedback; the log has rows only where ``log`` is set.

        ``torque`` and ``reference`` are (n, M); their last row stands for every later one. Rows become
        lists one at a time: half an hour at once would stall the cycle and take gigabytes.
        """
        cell, watch, stop = self.cell, self._watching, self.stop
        cycle = self.plan.cycle_s
        feedback, origin, velocity = self._feedback, self._origin, self._velocity
        demand = self._demand
        first, last = rows
        edge = round(0.5 / cycle)
        shaken = (edge, cycles - edge)
        kept: tuple[list[list[float]], ...] = ([], [], [], [])
        instants: list[float] = []
        start: int | None = None
        fading = 0
        fade = max(1, round(FADE_S / cycle))
        k = 0
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
            sample = cell.exchange(demand)
            if start is None:
                start = sample.slot
            k = sample.slot - start
            if sink is not None:
                # an encoder that stands still is stuck, but not while the excitation fades in or out
                watch.excited = self._must_move if shaken[0] <= k < shaken[1] and not fading else set()
                self._expect_life(first <= k < last and not fading)
            watch.check(sample)
            self._differentiate(sample)
            if sink is not None and first <= k < last:
                self._recorded = True
                sink.row(sample, demand)
            if log:
                kept[0].append(list(demand))
                kept[1].append(list(sample.torque))
                kept[2].append(list(sample.position))
                kept[3].append(list(sample.fresh))
                instants.append(sample.time)
            k += 1
            if fading:
                fading += 1
                if fading > fade:
                    so_far = "the recording so far is kept" if self._recorded else "nothing was recorded yet"
                    raise SafetyStop(f"stopped on request; {so_far}")
            elif stop is not None and stop.is_set():
                fading = 1
                cycles = max(cycles, k + fade + 1)
            if sample.time >= self._next_report:
                self._next_report = sample.time + PROGRESS_S
                self._report(k * cycle)
        self._done_s += cycles * cycle
        demands, torques, positions, came = (np.asarray(part) for part in kept)
        return _Log(demands, torques, positions, came.astype(bool), np.asarray(instants))

    def _expect_life(self, expected: bool) -> None:
        """While a periodic excitation is recorded, held axes that tremble with it must go on trembling."""
        e = self._now
        if expected is self._living or e is None:
            return
        self._living = expected
        held = set(range(self._count)) - set(e.excited) if expected and e.period_samples else set()
        self._watching.standing.expect_life(held, e.period_samples)

    def _differentiate(self, sample: Sample) -> None:
        last, before, velocity, position = self._last, self._last_time, self._velocity, sample.position
        for i, fresh in enumerate(sample.fresh):
            if fresh and (dt := sample.time - before[i]) > 0:
                velocity[i] = (position[i] - last[i]) / dt
                last[i], before[i] = position[i], sample.time

    def _change(self, modes: Sequence[Mode], feedback: list[_Feedback]) -> None:
        """New modes and feedback. Torque starts at the bias, as the hold left it."""
        demand = list(self._zero)
        for f in feedback:
            demand[f.axis] = f.bias
        self._feedback, self._demand = feedback, demand
        if list(modes) != self._modes:
            self.cell.set_modes(modes, demand)
            self._modes = list(modes)
            self._watching.pause()
            self._velocity = [0.0] * self._count
            self._last_time = [0.0] * self._count
        self._watching.settle()

    # --- trials --------------------------------------------------------------------------------
    def _try_signs(self, axis: int) -> None:
        """Doublets of at most a tenth of the amplitude, longer and longer, until the axis has moved."""
        settings = self.config.axes[axis]
        name, limits = settings.name, settings.limits
        cycle = self.plan.cycle_s
        peak = max(float(np.abs(e.torque[:, axis]).max()) for e in self.plan.experiments)
        amplitude = self.config.safety.test_amplitude * (peak if peak > 0 else 0.5 * limits.torque)
        self._phase, self._now = f"trying the signs of {name}", None
        modes = self._resting_modes()
        modes[axis] = Mode.TORQUE
        others = [
            _Feedback(i, Gains(0.0, 0.0), self._bias[i], limit.limits.torque)
            for i, limit in enumerate(self.config.axes)
            if modes[i] is Mode.TORQUE
        ]
        self._change(modes, others)
        self._watching.held = set(range(self._count)) - {axis}
        resolution = self.cell.resolution[axis]
        # The slope is of the sampled position, so the axis must move many counts.
        wanted = max(TRIAL_COUNTS * resolution, TRIAL_WINDOW * limits.position)
        length = TRIAL_FIRST_S
        sign = 0.0
        seen: list[trials.Response] = []
        spoilt: list[trials.Response] = []
        doubted = asleep = False
        while True:
            wave = amplitude * doublet(round(length / cycle))
            quiet = max(8, round(trials.EDGE_S / cycle) + max(trials.LAGS))
            rows = np.zeros((wave.size + 2 * quiet, self._count))
            rows[quiet:-quiet, axis] = wave
            kept = self._play(rows, len(rows), log=True)
            found = trials.response(
                kept.time,
                kept.demand[:, axis] - self._bias[axis],
                kept.torque[:, axis] - self._bias[axis],
                kept.position[:, axis] - kept.position[0, axis],
                count=resolution,
                rated=self.cell.rated_torque[axis],
                fresh=kept.fresh[:, axis],
            )
            if found.late:
                # Nothing can be said of this one. A pause in a doublet leaves the axis drifting: catch it.
                spoilt.append(found)
                if len(spoilt) > LATE_TRIALS:
                    raise trials.too_late(name, [*seen, *spoilt])
                self._catch(axis, settings.inertia or found.inertia)
                self._change(modes, others)
                continue
            if asleep and found.displacement < LEAST_COUNTS * resolution:
                break
            if found.stood and not asleep and found.displacement >= LEAST_COUNTS * resolution:
                # It moved and then stood under a torque that moves it: once more before that is believed.
                asleep = True
                continue
            seen.append(found)
            sign = trials.sign_score(seen)
            if (sign < -trials.DECISIVE or found.opposed) and not doubted:
                # A wrong sign is wrong twice; a computer that was late in the first trial is not.
                doubted = True
                seen.clear()
                continue
            if sign < -trials.DECISIVE or (found.displacement >= wanted and sign > trials.DECISIVE):
                break
            if length * 2 > TRIAL_LAST_S or found.displacement > TRIAL_MOST * limits.position:
                break
            length *= 2
        unit, torque_unit = ("m", "N") if self.config.linear else ("rad", "N·m")
        if found.displacement < LEAST_COUNTS * resolution:
            raise SafetyStop(
                f"axis {name}: {amplitude:.3g} {torque_unit} for {length:.2g} s moved the encoder by "
                f"{found.displacement / resolution:.0f} counts: the brake is closed, the encoder is "
                "stuck, or friction is "
                "above the trial torque; free the axis, or raise limits.torque if the axis may take more"
            )
        if abs(sign) <= trials.DECISIVE:
            if sum(r.late_edges for r in seen) > sum(r.edges for r in seen):
                raise trials.too_late(name, [*seen, *spoilt])
            self.warnings.append(
                f"axis {name}: the trial could hardly tell the encoder's sign ({sign:+.1f} standard "
                "deviations); the encoder is coarse or the torque small"
            )
        trials.judge(name, found, sign, amplitude=amplitude, unit=unit, torque_unit=torque_unit)
        self._inertia[axis] = settings.inertia if settings.inertia is not None else found.inertia
        self._catch(axis, self._inertia[axis])
        if self.cell.can_hold[axis]:
            self._change(self._resting_modes(), [f for f in others if f.axis != axis])

    def _catch(self, axis: int, inertia: float) -> None:
        """Back to where it stood, gently."""
        self._inertia[axis] = inertia
        self._centre({axis}, lowest=3.0)
        self._play(None, round(CATCH_S / self.plan.cycle_s))

    def _centre(self, excited: set[int], *, lowest: float, path: bool = False) -> None:
        """Excited axes in torque mode around their place, the others held as configured."""
        cycle = self.plan.cycle_s
        modes: list[Mode] = []
        feedback = []
        for i, settings in enumerate(self.config.axes):
            limit = settings.limits.torque
            if i in excited:
                inertia = self._inertia.get(i) or settings.inertia or 0.0
                gains = following(inertia, cycle) if path else centring(inertia, lowest, cycle)
                modes.append(Mode.TORQUE)
                feedback.append(_Feedback(i, gains, self._bias[i], limit))
                continue
            held = self._hold_gains(i)
            modes.append(Mode.HOLD if held is None else Mode.TORQUE)
            if held is not None:
                feedback.append(_Feedback(i, held, self._bias[i], limit))
        self._change(modes, feedback)
        self._watching.held = set(range(self._count)) - excited

    def _hold_gains(self, axis: int) -> Gains | None:
        """Gains of a held axis; ``None``: inside the drive."""
        settings = self.config.axes[axis]
        held = master_hold(settings, self.plan.cycle_s)
        if held is not None:
            return held
        if self.cell.can_hold[axis]:
            return None
        # A drive without position mode is held by the master: half the torque limit at the window's edge.
        stiffness = 0.5 * settings.limits.torque / settings.limits.position
        return Gains(stiffness, max(least_damping(stiffness, self.plan.cycle_s), 0.1 * stiffness))

    def _lowest(self, experiments: Sequence[PlannedExperiment]) -> float:
        lines = [float(e.frequencies_hz.min()) for e in experiments if e.frequencies_hz.size]
        lines += [float(e.attributes["band_hz"][0]) for e in experiments if "band_hz" in e.attributes]
        return min(lines, default=1.0)

    def _try_amplitude(self) -> None:
        """A tenth, then a third of the largest shaking: does full amplitude stay within the limits?"""
        shaking = [e for e in self.plan.experiments if e.kind is not Kind.CONSTANT_VELOCITY]
        if not shaking:
            return
        peaks = [float(np.abs(e.torque).max(initial=0.0)) for e in shaking]
        # the first of the largest; runs of one multisine differ by rounding
        experiment = next(e for e, p in zip(shaking, peaks, strict=True) if p >= 0.999 * max(peaks))
        share = self.config.safety.test_amplitude
        self._phase, self._now = "trying the amplitude", experiment
        self._centre(set(experiment.excited), lowest=self._lowest([experiment]))
        self._watching.standing.slowest(self._lowest([experiment]))
        self._try_share(experiment, share, TRIAL_PERIOD_S)
        self._try_share(experiment, min(float(np.sqrt(share)), NEAR_LIMIT) * self._scale, CLIMB_S)

    def _try_share(self, experiment: PlannedExperiment, share: float, seconds: float) -> None:
        """The first seconds at a share of the amplitude, and what full amplitude would be by them."""
        excited, cycle = set(experiment.excited), self.plan.cycle_s
        cycles = min(experiment.cycles, round(seconds / cycle))
        # the fades at the ends of the excitation stand still by themselves
        fade = min(round(0.5 / cycle), cycles // 4)
        rows = ramped(experiment.torque[:cycles] * share, 0, fade)
        opening = self._play(rows[:fade], fade, log=True)
        self._watching.excited = excited
        body = self._play(rows[fade:-fade], cycles - 2 * fade, log=True)
        self._watching.excited = set()
        self._watching.learn_standing(excited)
        position, time, fresh = (
            np.concatenate(parts)
            for parts in (
                (opening.position, body.position),
                (opening.time, body.time),
                (opening.fresh, body.fresh),
            )
        )
        self._play(rows[-fade:], fade)
        self._play(None, round(self.plan.rest_s / cycle))
        for i in sorted(excited):
            limits = self.config.axes[i].limits
            came = fresh[:, i]
            motion, instants = position[came, i] - self._origin[i], time[came]
            travel = float(np.abs(motion).max(initial=0.0)) / share
            step = max(1, round(0.004 / cycle))
            moved = np.abs(motion[step:] - motion[:-step]) - self.cell.resolution[i]
            # over the time it took: a skipped slot would pass for a leap
            velocity = float((moved / (instants[step:] - instants[:-step])).max(initial=0.0)) / share
            for what, value, limit in (
                ("travel", travel, limits.position),
                ("velocity", velocity, limits.velocity),
            ):
                if value * self._scale > NEAR_LIMIT * limit:
                    self._scale = NEAR_LIMIT * limit / value
                    self.warnings.append(
                        f"axis {self.plan.axes[i]}: at full amplitude the {what} would be {value:.3g}, limit "
                        f"{limit:g}; every torque is scaled by {self._scale:.2f}"
                    )

    # --- experiments ---------------------------------------------------------------------------
    def _enough(self, number: int) -> bool:
        """Whether the measurement may end after this experiment; holds every axis until that is known."""
        if self.go_on is None:
            return False
        self._phase, self._now = "judging what was measured", None
        for _ in range(round(DECIDE_S / DECIDE_POLL_S)):
            answer = self.go_on(number)
            if answer is not None:
                return not answer
            self._play(None, max(1, round(DECIDE_POLL_S / self.plan.cycle_s)))
        self.warnings.append(
            f"nobody said within {DECIDE_S:g} s whether to go on after experiment {number + 1}: ended there"
        )
        return True

    def _experiment(self, experiment: PlannedExperiment, number: int) -> None:
        self._phase = f"experiment {number + 1} of {len(self.plan.experiments)}"
        self._now = experiment
        path = experiment.kind is Kind.CONSTANT_VELOCITY
        excited = set(experiment.excited)
        self._centre(excited, lowest=self._lowest([experiment]), path=path)
        cycle = self.plan.cycle_s
        self._play(None, round(self.plan.rest_s / cycle))
        gains = [float("nan")] * self._count
        for f in self._feedback:
            gains[f.axis] = f.gains.stiffness
        self.sink.begin(experiment, gains, self._scale)
        self._must_move = set() if path else excited
        self._watching.standing.slowest(self._lowest([experiment]))
        try:
            self._play(
                experiment.torque,
                experiment.cycles,
                reference=experiment.reference,
                scale=self._scale,
                sink=self.sink,
                rows=(experiment.record_from, experiment.record_to),
            )
        finally:
            self._must_move = set()
            self._watching.excited = set()
            self._expect_life(False)
            self.sink.end()

    def _report(self, within: float = 0.0) -> None:
        if self.progress is None:
            return
        done = min(self._done_s + within, self._total_s)
        e = self._now
        self.progress(
            Progress(
                phase=self._phase,
                axis=self.plan.axes[e.excited[0]] if e is not None and len(e.excited) == 1 else None,
                frequency=float(e.frequencies_hz[0])
                if e is not None and e.frequencies_hz.size == 1
                else None,
                fraction=done / self._total_s if self._total_s > 0 else 1.0,
                eta_s=max(self._total_s - done, 0.0),
            )
        )
