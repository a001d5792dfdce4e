"""Trials before the full amplitude: the signs of each axis, then a tenth and a third of the shaking."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.errors import SafetyStop
from invid.numerics.arrays import Float64
from invid.planning.forecast import FULL, QUANTITIES, READING, announced, limits_of
from invid.planning.hold_laws import Gains
from invid.planning.model import AxisForecast, PlannedExperiment, Trial
from invid.planning.phases import (
    CATCH_HZ,
    FIRST_S,
    SIGN_CATCH_S,
    SIGN_FIRST_S,
    SIGN_LAST_S,
    SIGN_MOST,
    excerpt,
    lowest_frequency,
    sign_amplitude,
    sign_wanted,
    trial_shares,
)
from invid.recording.model import Kind
from invid.signals.excitation import doublet
from invid.sweep import trials
from invid.sweep.motion import Feedback, Log, Motion, joined
from invid.sweep.ports import Mode

TRIAL_CLIMB, TRIAL_AGAIN_S = 2.0, 0.08
"""Where the longest doublet does not move an axis, its torque is doubled, up to what is planned, and it
begins again at this length."""
LATE_TRIALS = 20
"""Trials that say nothing because somebody was late, before the measurement gives up: seven seconds at least,
so that a few in which a computer is busy with something else do not end it; each trial is as small as the
others and the axis is caught after it. Empirical: a machine on which one SYNC in twenty comes late spoils one
doublet in three."""
SLEEP_COUNTS = 20
"""An encoder that dies shows so many counts first; fewer are what ringing leaves of a coarse one."""
LEAST_COUNTS = 5
"""Less than this after the longest doublet, and the axis did not move."""
GENTLE, LEAST_SHARE = 1.0 / 3.0, 0.01
SMOOTH_S = 0.02
"""The torque that a drive reads while it holds is averaged over this time: shorter than what is shaken."""
NOISE_STD = 4.0
"""Standard deviations of its noise (0.5 % of rated) taken off its peak."""
MOST_GROWTH = 1.6
"""A straight line through zero at a tenth of the amplitude and the motion at a third rises so much; one that
begins later has stuck there, and nothing more can be said."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What an excerpt did at a share of its amplitude.

    ``motion`` (2, M): largest travel and velocity; ``early``: those of the first seconds, common to both
    steps of a trial; ``torque`` (M,): largest torque beyond what rest asks for.
    """

    share: float
    motion: Float64
    early: Float64
    torque: Float64

    @property
    def stacked(self) -> Float64:
        """(3, M)."""
        return np.concatenate([self.motion, self.torque[None]])


class Rehearsal:
    """What is tried before anything is recorded."""

    def __init__(self, motion: Motion, warnings: list[str]) -> None:
        self._motion = motion
        self.warnings = warnings
        self.scales = np.ones(len(motion.plan.experiments))
        """Factor on the torque of every experiment; below 1 where a limit would be near."""
        self.bounds: Float64 = np.zeros((3, motion.count))
        """(3, M) travel, velocity and torque of the experiments, by the trials."""

    def try_signs(self, axis: int) -> None:
        """Doublets of a tenth of the amplitude, longer and then stronger, until the axis has moved."""
        settings = self._motion.config.axes[axis]
        name, limits = settings.name, settings.limits
        cycle = self._motion.plan.cycle_s
        amplitude, most = sign_amplitude(self._motion.config, self._motion.plan.experiments, axis)
        self._motion.phase, self._motion.experiment = f"trying the signs of {name}", None
        modes = self._motion.resting_modes()
        modes[axis] = Mode.TORQUE
        others = [
            Feedback(i, Gains(0.0, 0.0), self._motion.bias[i], limit.limits.torque)
            for i, limit in enumerate(self._motion.config.axes)
            if modes[i] is Mode.TORQUE
        ]
        self._motion.change(modes, others)
        self._motion.watching.held = set(range(self._motion.count)) - {axis}
        resolution = self._motion.cell.resolution[axis]
        # The slope is of the sampled position, so the axis must move many counts.
        wanted = sign_wanted(limits, resolution)
        length = SIGN_FIRST_S
        sign = 0.0
        seen: list[trials.Response] = []
        spoilt: list[trials.Response] = []
        doubted = asleep = False
        while True:
            wave = amplitude * doublet(round(length / cycle))
            quiet = max(8, round(trials.EDGE_S / cycle) + max(trials.LAGS))
            rows = np.zeros((wave.size + 2 * quiet, self._motion.count))
            rows[quiet:-quiet, axis] = wave
            kept = self._motion.play(rows, len(rows), log=True)
            found = trials.response(
                kept.time,
                kept.demand[:, axis] - self._motion.bias[axis],
                kept.torque[:, axis] - self._motion.bias[axis],
                kept.position[:, axis] - kept.position[0, axis],
                count=resolution,
                rated=self._motion.cell.rated_torque[axis],
                fresh=kept.fresh[:, axis],
            )
            if found.late:
                # Nothing can be said of this one. A pause in a doublet leaves the axis drifting: catch it.
                spoilt.append(found)
                if len(spoilt) > LATE_TRIALS:
                    raise trials.too_late(name, [*seen, *spoilt])
                self._catch(axis, self._motion.plan.inertia[axis] or found.inertia)
                self._motion.change(modes, others)
                continue
            if asleep and found.displacement < LEAST_COUNTS * resolution:
                break
            if found.stood and not asleep and found.displacement >= SLEEP_COUNTS * resolution:
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
            if found.displacement > SIGN_MOST * limits.position:
                break
            if length * 2 <= SIGN_LAST_S:
                length *= 2
                continue
            if amplitude * TRIAL_CLIMB > most or found.displacement >= wanted:
                break
            # What holds it against a small torque is most often friction; a stronger doublet starts short.
            amplitude, length = TRIAL_CLIMB * amplitude, TRIAL_AGAIN_S
        unit, torque_unit = ("m", "N") if self._motion.config.linear else ("rad", "N·m")
        if found.displacement < LEAST_COUNTS * resolution:
            raise SafetyStop(
                f"axis {name}: {amplitude:.3g} {torque_unit} for {length:.2g} s moved the encoder by "
                f"{found.displacement / resolution:.0f} counts: the brake is closed, the encoder is stuck, "
                "or friction takes all of the planned torque; see that the brake opens and turn the axis by "
                "hand"
            )
        if abs(sign) <= trials.DECISIVE:
            if sum(r.late_edges for r in seen) > sum(r.edges for r in seen):
                raise trials.too_late(name, [*seen, *spoilt])
            self.warnings.append(
                f"axis {name}: the trial could hardly tell the encoder's sign ({sign:+.1f} standard "
                "deviations); the encoder is coarse or the torque small"
            )
        trials.judge(name, found, sign, amplitude=amplitude, unit=unit, torque_unit=torque_unit)
        known = self._motion.plan.inertia[axis]
        self._motion.inertia[axis] = known if known is not None else found.inertia
        self._catch(axis, self._motion.inertia[axis])
        if self._motion.cell.can_hold[axis]:
            self._motion.change(self._motion.resting_modes(), [f for f in others if f.axis != axis])

    def _catch(self, axis: int, inertia: float) -> None:
        """Back to where it stood, gently."""
        self._motion.inertia[axis] = inertia
        self._motion.centre({axis}, lowest=CATCH_HZ)
        self._motion.play(None, round(SIGN_CATCH_S / self._motion.plan.cycle_s))

    def try_amplitude(self, trial: Trial) -> None:
        """A tenth, then a third of the shaking: does full amplitude stay within what was announced?

        What is measured there, times what the experiments may do beyond it, bounds them; every torque of the
        plan is scaled down where that bound lies beyond the announced figures or 95 % of a limit.
        """
        experiment, config = trial.experiment, self._motion.config
        self._motion.phase, self._motion.experiment = "trying the amplitude", experiment
        lowest = lowest_frequency([experiment])
        self._motion.rest(set(experiment.excited))
        self._motion.watching.standing.slowest(lowest)
        self._motion.watching.standing.forget()
        first, second = trial_shares(config, experiment)
        allowed = self._allowed()
        gentle = self._gentle(experiment, allowed[0])
        # Less than what friction surely lets through says nothing of an encoder that stands.
        seen = self._try_share(excerpt(config, trial, 0), min(first, gentle), moves=gentle >= first)
        first = min(first, gentle)
        # Friction may have hidden half of the motion.
        room = float(np.min(allowed[:2] / np.maximum(2.0 * seen.motion, 1e-300)))
        share = min(second, first * max(room, 1.0))
        again = self._try_share(excerpt(config, trial, 1), share)
        linear = again.stacked / share
        linear[:2] *= _growth(seen, again)
        path = experiment.reference
        led = 0.0 if path is None else np.abs(path).max(axis=0)

        def bound(spread: Float64) -> Float64:
            most: Float64 = linear * spread
            most[2] += np.abs(self._motion.bias)
            most[0] += led
            return most

        scale = self._scale_down(bound(trial.usual), allowed)
        self.scales[list(trial.covers)] = scale
        self.bounds = np.maximum(self.bounds, scale * bound(trial.spread))

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

    def _allowed(self) -> Float64:
        """(3, M) what was announced, or 95 % of the limits where that is less."""
        plan, config = self._motion.plan, self._motion.config
        told = np.array([[f.travel, f.velocity, f.peak_torque] for f in plan.forecast]).T
        allowed: Float64 = np.minimum(told, FULL * limits_of(config))
        return allowed

    def _scale_down(self, bound: Float64, allowed: Float64) -> float:
        """The largest scale at which the bounds are allowed; what it is for becomes a warning."""
        share = allowed / np.maximum(bound, 1e-300)
        if share.min() >= 1.0:
            return 1.0
        k, i = np.unravel_index(int(np.argmin(share)), share.shape)
        units = ("m", "m/s", "N") if self._motion.config.linear else ("rad", "rad/s", "N·m")
        self.warnings.append(
            f"axis {self._motion.plan.axes[i]}: at the planned amplitude the {QUANTITIES[k]} could be "
            f"{bound[k, i]:.3g} {units[k]} by the trial, {allowed[k, i]:.3g} is allowed; every torque is "
            f"scaled by {share[k, i]:.2f}"
        )
        return float(share[k, i])

    def forecast(self) -> tuple[AxisForecast, ...]:
        """What is announced after the trials: never more than before them."""
        plan, config = self._motion.plan, self._motion.config
        told = np.array([[f.travel, f.velocity, f.peak_torque] for f in plan.forecast]).T
        if not self.bounds.any() or all(f.basis == "model" for f in plan.forecast):
            return plan.forecast
        bounds = self.bounds.copy()
        bounds[2] += READING * np.array(self._motion.cell.rated_torque)
        bounds = np.maximum(bounds, self._motion.watching.peaks)
        for e in plan.experiments:
            if e.kind is Kind.CONSTANT_VELOCITY:  # follows its path, with what torque that takes
                bounds[:, list(e.excited)] = told[:, list(e.excited)]
        return announced(config, np.minimum(bounds, told), "trial")

    def _try_share(self, experiment: PlannedExperiment, share: float, *, moves: bool = True) -> Seen:
        """What an excerpt does at a share of its amplitude; ``moves``: whether it must move its axes."""
        motion = self._motion
        excited, cycle = set(experiment.excited), motion.plan.cycle_s
        cycles = experiment.cycles
        # the fades at the ends of the excitation stand still by themselves
        fade = min(round(0.5 / cycle), cycles // 4)
        motion.centre(excited, lowest=lowest_frequency([experiment]))
        before = np.array(motion.place)
        rows, path = experiment.torque * share, experiment.reference

        def play(first: int, last: int) -> Log:
            part = None if path is None else path[first:last]
            return motion.play(rows[first:last], last - first, reference=part, log=True)

        opening = play(0, fade)
        motion.watching.excited = excited if moves else set()
        body = play(fade, cycles - fade)
        motion.watching.excited = set()
        if moves:
            motion.watching.learn_standing(excited)
        ending = play(cycles - fade, cycles)
        rest = motion.rest(excited)
        kept = joined([opening, body, ending, rest])
        led = np.zeros_like(kept.position) if path is None else _until(path, len(kept.position))
        travel, velocity = np.zeros(motion.count), np.zeros(motion.count)
        early = np.zeros((2, motion.count))
        step = max(1, round(0.004 / cycle))
        common = round(FIRST_S / cycle) - fade
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
        return Seen(share, np.stack([travel, velocity]), early, self._torque(joined([opening, body, ending])))

    def _torque(self, kept: Log) -> Float64:
        """(M,) largest torque beyond the bias: commanded, or measured where a drive holds its axis."""
        motion = self._motion
        bias, rated = np.array(motion.bias), np.array(motion.cell.rated_torque)
        commanded = np.abs(kept.demand - bias).max(axis=0, initial=0.0)
        window = max(1, round(SMOOTH_S / motion.plan.cycle_s))
        total = np.cumsum(np.concatenate([np.zeros((1, motion.count)), kept.torque - bias]), axis=0)
        smooth = np.abs(total[window:] - total[:-window]).max(axis=0, initial=0.0) / window
        noise = NOISE_STD * READING / 6 * rated / np.sqrt(window)
        led = [f.axis for f in motion.feedback]
        held = ~np.isin(np.arange(motion.count), led)
        largest: Float64 = np.where(held, np.maximum(smooth - noise, 0.0), commanded)
        return largest


def _until(path: Float64, rows: int) -> Float64:
    """The path, its last place kept."""
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
