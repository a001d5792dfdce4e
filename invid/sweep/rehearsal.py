"""Try the signs of each axis, then a tenth and a third of the shaking, before the full amplitude."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from invid.numerics.arrays import Float64
from invid.planning.forecast import (
    DRIVE_HOLDS_HZ,
    MOST_GROWTH,
    QUANTITIES,
    READING_NOISE,
    USABLE_SHARE,
    announced,
    limits_of,
)
from invid.planning.model import AxisForecast, PlannedExperiment, Trial
from invid.planning.phases import excerpt, highest_frequency, lowest_frequency, trial_shares
from invid.recording.model import Kind
from invid.sweep.motion import Log, Motion, RowSink, joined
from invid.sweep.ports import Procedure, Sink
from invid.sweep.sign_trial import SignTrial
from invid.wording.sentence import sentence

GENTLE, LEAST_SHARE = 1.0 / 3.0, 0.01
SMOOTH_S, SMOOTH_CYCLE = 0.02, 0.2
"""The torque that a drive reads while it holds is averaged over this time, and no more than a fifth of the
fastest cycle that is shaken, which takes 6 % off its amplitude."""
NOISE_STD = 3.0
"""Standard deviations of its noise (0.5 % of rated) that the peak of some hundred averages has without any
torque. They are taken off in power: a peak of torque is higher by its noise, but not by the peak of it."""
CLIMB, SHORT = 5.0, 3.0
"""A step of a trial has at most five times the torque of the one before, whose motion friction may have
hidden wholly; where a third of what is allowed is not reached in the second, and its torque is still below
the usual, there is another."""
BISECTIONS = 12
"""A scale is sought to a four-thousandth."""


@dataclass(frozen=True, eq=False)
class Seen:
    """Largest motion and torque of an excerpt at a share of its amplitude.

    ``motion`` (2, M): largest travel and velocity; ``early``: those of the first seconds, common to both
    steps of a trial; ``torque`` (M,): largest torque beyond what rest asks for.
    """

    share: float
    motion: Float64
    early: Float64
    torque: Float64

    @property
    def stacked(self) -> Float64:
        """Return travel, velocity and torque as one (3, M) array."""
        return np.concatenate([self.motion, self.torque[None]])


class Rehearsal:
    """The trials that are made before anything is recorded."""

    def __init__(
        self,
        motion: Motion,
        warnings: list[str],
        stated: Sequence[tuple[float, str] | None],
        permitted: Callable[[float], Float64],
        sink: Sink,
    ) -> None:
        self._motion, self._sink = motion, sink
        self._stated = stated
        """Inertia of each axis and who says it."""
        self._permitted = permitted
        """(M,) speed that is permitted while a share of the plan's torque is played."""
        self.warnings = warnings
        self.scales = np.ones(len(motion.plan.experiments))
        """Factor on the torque of every experiment; below 1 where a limit would be near."""
        self._sure: Float64 = np.zeros(motion.count)
        """(M,) least torque with which an axis must move: friction may hold one that is shaken with less than
        it was tried with."""
        self._as_foretold: set[int] = set()
        """Axes that doublets of a tenth of the amplitude moved as the model says."""
        self.bounds: Float64 = np.zeros((3, motion.count))
        """(3, M) travel, velocity and torque of the experiments, by the trials."""

    def try_signs(self, axis: int) -> Procedure[None]:
        """Play doublets of a tenth of the amplitude: signs, motion, and scales against the stated inertia."""
        if (yield from SignTrial(self._motion, axis, self._stated[axis], self.warnings).run()):
            self._as_foretold.add(axis)

    def try_amplitude(self, trial: Trial) -> Procedure[None]:
        """Play a tenth, then a third of the shaking: does full amplitude stay within what was announced?

        What is measured there, times what the experiments may do beyond it, bounds them; every torque of the
        plan is scaled down where that bound lies beyond the announced figures or 95 % of a limit.
        """
        experiment, config = trial.experiment, self._motion.config
        self._motion.phase, self._motion.experiment = "trying the amplitude", experiment
        yield from self._motion.rest(set(experiment.excited))
        sure, second = trial_shares(config, experiment)
        # the speed that is permitted to all of the second step's torque is permitted to less
        allowed = self._allowed(experiment, second)

        def tried(step: int, share: float) -> Procedure[Seen]:
            for i, velocity in enumerate(self._permitted(share).tolist()):
                self._motion.permit(i, velocity)
            # Less than what friction surely lets through says nothing of an encoder that stands.
            return (yield from self._try_share(trial, step, share, moves=share >= sure))

        if trial.is_foretold and set(experiment.excited) <= self._as_foretold:
            # at a third, an axis that moves ``AGREES`` times as foretold hardly leaves what is announced
            share, again = second, (yield from tried(1, second))
            linear = again.stacked / second
        else:
            first = min(sure, self._gentle(experiment, allowed[0]))
            seen = yield from tried(0, first)
            share = min(second, first * min(self._room(seen, allowed), CLIMB))
            again = yield from tried(1, share)
            linear = self._extrapolated(seen, again)
        while share < second and self._room(again, allowed) > SHORT:
            # Friction hid so much of the motion that the second step was still a small one.
            share = min(second, share * min(self._room(again, allowed), CLIMB))
            seen, again = again, (yield from tried(0, share))
            linear = np.maximum(linear, self._extrapolated(seen, again))
        path = experiment.reference
        led = 0.0 if path is None else np.abs(path).max(axis=0)

        peak = np.abs(experiment.torque).max(axis=0, initial=0.0)
        self._sure = np.maximum(self._sure, np.where(peak > 0, sure * peak, 0.0))

        def bound(spread: Float64) -> Float64:
            most: Float64 = linear * spread
            most[2] += np.abs(self._motion.bias)
            most[0] += led
            return most

        scale = self._scale_down(bound(trial.usual), experiment)
        self.scales[list(trial.covers)] = scale
        most = bound(trial.spread)
        most[2] = np.maximum(most[2], self._led(experiment, linear[2], trial.spread[0]))
        self.bounds = np.maximum(self.bounds, scale * most)

    def _led(self, experiment: PlannedExperiment, torque: Float64, spread: Float64) -> Float64:
        """Return the (M,) torque of shaken axes: what is played is known, what the loop adds spreads as
        travel does.
        """
        played = np.abs(experiment.torque).max(axis=0)
        shaken = np.isin(np.arange(played.size), experiment.excited)
        most: Float64 = played + spread * np.maximum(torque - played, 0.0) + np.abs(self._motion.bias)
        return np.where(shaken, most, 0.0)

    @staticmethod
    def _room(seen: Seen, allowed: Float64) -> float:
        """Return how much further what is allowed lies, if friction hid half of the motion; at least 1."""
        return max(1.0, float(np.min(allowed[:2] / np.maximum(2.0 * seen.motion, 1e-300))))

    @staticmethod
    def _extrapolated(first: Seen, second: Seen) -> Float64:
        """Return (3, M) what full amplitude does by the second of two shares."""
        linear: Float64 = second.stacked / second.share
        linear[:2] *= _growth(first, second)
        return linear

    def _gentle(self, experiment: PlannedExperiment, travel: Float64) -> float:
        """Share at which a sine of the slowest line moves each axis, as heavy as the signs showed it, by less
        than a third of what is allowed."""
        omega = 2 * np.pi * lowest_frequency([experiment])
        share = 1.0
        for i in experiment.excited:
            peak = float(np.abs(experiment.torque[:, i]).max(initial=0.0))
            inertia = self._motion.inertia.get(i, 0.0)
            if peak > 0 and 0 < inertia < np.inf:
                share = min(share, GENTLE * float(travel[i]) * inertia * omega**2 / peak)
        return max(share, LEAST_SHARE)

    def moved_by(self, torque: Float64) -> set[int]:
        """Axes that so much torque (M,) must move."""
        return {i for i in range(torque.size) if torque[i] >= (1 - 1e-9) * self._sure[i]}

    def _allowed(self, experiment: PlannedExperiment, played: float) -> Float64:
        """(3, M) what was announced, or the plan's share of 95 % of the limits where that is less.

        ``played``: share of the torque, on which the permitted speed depends.
        """
        plan, config = self._motion.plan, self._motion.config
        told = _announced(plan.forecast)
        most = USABLE_SHARE * limits_of(config)
        most[1] = USABLE_SHARE * self._permitted(played)
        if experiment.reference is None:
            rest = np.zeros_like(most)
            rest[2] = np.minimum(np.abs(self._motion.bias), most[2])
            most = rest + plan.share * (most - rest)
        allowed: Float64 = np.minimum(told, most)
        return allowed

    def _scale_down(self, bound: Float64, experiment: PlannedExperiment) -> float:
        """The largest scale at which the bounds are allowed; what it is for becomes a warning."""

        def share(played: float) -> Float64:
            over: Float64 = self._allowed(experiment, played) / np.maximum(bound, 1e-300)
            return over

        if share(1.0).min() >= 1.0:
            return 1.0
        # less torque may be faster: the largest scale that is permitted to the torque that it leaves
        low, high = float(share(1.0).min()), 1.0
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            low, high = (middle, high) if share(middle).min() >= middle else (low, middle)
        found = share(low)
        k, i = np.unravel_index(int(np.argmin(found)), found.shape)
        units = ("m", "m/s", "N") if self._motion.config.linear else ("rad", "rad/s", "N·m")
        self.warnings.append(
            sentence(
                "axis {axis}: at the planned amplitude the {quantities} could be {bound:.3g} "
                "{units} by the trial, {found:.3g} is allowed; every torque is scaled by {low:.2f}",
                axis=self._motion.plan.axes[i],
                quantities=QUANTITIES[k],
                bound=bound[k, i],
                units=units[k],
                found=found[k, i] * bound[k, i],
                low=low,
            )
        )
        return low

    def forecast(self) -> tuple[AxisForecast, ...]:
        """Return what is announced after the trials: never more than before them."""
        plan, config = self._motion.plan, self._motion.config
        told = _announced(plan.forecast)
        if not self.bounds.any() or all(f.basis == "model" for f in plan.forecast):
            return plan.forecast
        bounds = self.bounds.copy()
        bounds[2] = np.maximum(bounds[2], self._taken_over())
        bounds[2] += READING_NOISE * np.array(self._motion.cell.rated_torque)
        bounds = np.maximum(bounds, self._motion.watching.bounds.peaks)
        for e in plan.experiments:
            if e.kind is Kind.CONSTANT_VELOCITY:  # follows its path, with what torque that takes
                bounds[:, list(e.excited)] = told[:, list(e.excited)]
        return announced(config, np.minimum(bounds, told), "trial")

    def _taken_over(self) -> Float64:
        """(M,) torque with which a drive takes over an axis that stands half a count off its place."""
        motion, stiffest = self._motion, (2 * np.pi * DRIVE_HOLDS_HZ[-1]) ** 2
        return np.array(
            [
                abs(motion.bias[i]) + 0.5 * motion.cell.resolution[i] * motion.inertia.get(i, 0.0) * stiffest
                if axis.hold.mode == "drive" and motion.cell.can_hold[i]
                else 0.0
                for i, axis in enumerate(motion.config.axes)
            ]
        )

    def _try_share(self, trial: Trial, step: int, share: float, *, moves: bool) -> Procedure[Seen]:
        """Play an excerpt at a share of its amplitude and return what it did; ``moves``: whether it
        must move its axes. A climb is recorded where the trial says so.
        """
        motion = self._motion
        experiment, first = (excerpt(motion.config, trial, k) for k in (step, 0))
        recorded = bool(trial.recorded_share) and step == 1
        excited, cycle = set(experiment.excited), motion.plan.cycle_s
        cycles, path = experiment.cycles, experiment.reference
        fade = min(round(0.5 / cycle), cycles // 4)
        yield from motion.centre(excited, lowest=lowest_frequency([experiment]))
        before = np.array(motion.place)
        motion.watching.words.begin()
        if recorded:
            self._sink.begin(experiment, motion.stated_holds(), share)
        taken = RowSink(self._sink, 0, cycles, is_logged=True) if recorded else None
        motion.watching.expect_motion(excited if moves else (), lowest_frequency([experiment]))
        body = yield from motion.play(experiment.torque * share, cycles, reference=path, recording=taken)
        motion.watching.expect_motion(())
        motion.watching.words.require_no_limit(range(motion.count), f"{share:.0%} of the planned amplitude")
        if recorded:
            self._sink.end()
        rest = yield from motion.rest(excited)
        kept = joined([body, rest])
        if experiment.kind is not Kind.CHIRP or experiment.cycles == trial.experiment.cycles:
            motion.learn(experiment, kept)  # the half of a sweep tells nothing of its other lines
        led = np.zeros_like(kept.position) if path is None else _until(path, len(kept.position))
        travel, velocity = np.zeros(motion.count), np.zeros(motion.count)
        early = np.zeros((2, motion.count))
        step = max(1, round(0.004 / cycle))
        common = first.cycles - fade
        for i in range(motion.count):
            came = np.flatnonzero(kept.fresh[:, i])
            away = np.abs(kept.position[came, i] - led[came, i] - before[i])
            moved = np.abs(kept.position[came[step:], i] - kept.position[came[:-step], i])
            # over the time it took: a skipped slot would pass for a leap
            speed = (moved - motion.cell.resolution[i]) / (kept.time[came[step:]] - kept.time[came[:-step]])
            travel[i], velocity[i] = away.max(initial=0.0), max(speed.max(initial=0.0), 0.0)
            early[0, i] = away[came < common].max(initial=0.0)
            early[1, i] = max(speed[came[step:] < common].max(initial=0.0), 0.0)
        # the rest has a hold of its own, whatever the share
        torque = self._torque(body, highest_frequency([experiment]))
        return Seen(share, np.stack([travel, velocity]), early, torque)

    def _torque(self, kept: Log, highest: float) -> Float64:
        """(M,) largest torque beyond the bias: commanded, or measured where a drive holds its axis.

        ``highest`` is the fastest line that is shaken [Hz].
        """
        motion = self._motion
        bias, rated = np.array(motion.bias), np.array(motion.cell.rated_torque)
        commanded = np.abs(kept.demand - bias).max(axis=0, initial=0.0)
        window = max(1, round(min(SMOOTH_S, SMOOTH_CYCLE / highest) / motion.plan.cycle_s))
        total = np.cumsum(np.concatenate([np.zeros((1, motion.count)), kept.torque - bias]), axis=0)
        smooth = np.abs(total[window:] - total[:-window]).max(axis=0, initial=0.0) / window
        noise = NOISE_STD * READING_NOISE / 6 * rated / np.sqrt(window)
        led = [f.axis for f in motion.feedback]
        held = ~np.isin(np.arange(motion.count), led)
        largest: Float64 = np.where(held, np.sqrt(np.maximum(smooth**2 - noise**2, 0.0)), commanded)
        return largest


def _announced(forecast: Sequence[AxisForecast]) -> Float64:
    """(3, M) travel, velocity and torque."""
    return np.array([[f.travel, f.velocity, f.peak_torque] for f in forecast]).T


def _until(path: Float64, rows: int) -> Float64:
    """Return the path for so many cycles, its last place kept."""
    result: Float64 = path[np.minimum(np.arange(rows), len(path) - 1)]
    return result


def _growth(first: Seen, second: Seen) -> Float64:
    """(2, M) how much more than in proportion to the torque an axis moves at full amplitude.

    Dry friction takes a constant share of the torque: motion over amplitude is a straight line that begins
    above zero. It is drawn through the same seconds at both shares.
    """
    slope = (second.early - first.early) / max(second.share - first.share, 1e-9)
    full = second.early + slope * (1.0 - second.share)
    growth: Float64 = np.clip(full * second.share / np.maximum(second.early, 1e-300), 1.0, MOST_GROWTH)
    return growth
