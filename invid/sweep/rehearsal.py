"""Trials before the full amplitude: the signs of each axis, then a tenth and a third of the shaking."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.errors import SafetyStop
from invid.planning.hold_laws import Gains
from invid.planning.model import PlannedExperiment
from invid.recording.model import Kind
from invid.signals.excitation import doublet, ramped
from invid.sweep import trials
from invid.sweep.motion import Feedback, Motion
from invid.sweep.ports import Mode

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


class Rehearsal:
    """What is tried before anything is recorded."""

    def __init__(self, motion: Motion, warnings: list[str]) -> None:
        self._motion = motion
        self.warnings = warnings
        self.scale = 1.0
        """Factor on every torque of the plan; below 1 where a limit would be near."""

    def try_signs(self, axis: int) -> None:
        """Doublets of at most a tenth of the amplitude, longer and longer, until the axis has moved."""
        settings = self._motion.config.axes[axis]
        name, limits = settings.name, settings.limits
        cycle = self._motion.plan.cycle_s
        peak = max(float(np.abs(e.torque[:, axis]).max()) for e in self._motion.plan.experiments)
        amplitude = self._motion.config.safety.test_amplitude * (peak if peak > 0 else 0.5 * limits.torque)
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
        wanted = max(TRIAL_COUNTS * resolution, TRIAL_WINDOW * limits.position)
        length = TRIAL_FIRST_S
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
                self._catch(axis, settings.inertia or found.inertia)
                self._motion.change(modes, others)
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
        unit, torque_unit = ("m", "N") if self._motion.config.linear else ("rad", "N·m")
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
        self._motion.inertia[axis] = settings.inertia if settings.inertia is not None else found.inertia
        self._catch(axis, self._motion.inertia[axis])
        if self._motion.cell.can_hold[axis]:
            self._motion.change(self._motion.resting_modes(), [f for f in others if f.axis != axis])

    def _catch(self, axis: int, inertia: float) -> None:
        """Back to where it stood, gently."""
        self._motion.inertia[axis] = inertia
        self._motion.centre({axis}, lowest=3.0)
        self._motion.play(None, round(CATCH_S / self._motion.plan.cycle_s))

    def try_amplitude(self) -> None:
        """A tenth, then a third of the largest shaking: does full amplitude stay within the limits?"""
        shaking = [e for e in self._motion.plan.experiments if e.kind is not Kind.CONSTANT_VELOCITY]
        if not shaking:
            return
        peaks = [float(np.abs(e.torque).max(initial=0.0)) for e in shaking]
        # the first of the largest; runs of one multisine differ by rounding
        experiment = next(e for e, p in zip(shaking, peaks, strict=True) if p >= 0.999 * max(peaks))
        share = self._motion.config.safety.test_amplitude
        self._motion.phase, self._motion.experiment = "trying the amplitude", experiment
        self._motion.centre(set(experiment.excited), lowest=lowest_frequency([experiment]))
        self._motion.watching.standing.slowest(lowest_frequency([experiment]))
        self._try_share(experiment, share, TRIAL_PERIOD_S)
        self._try_share(experiment, min(float(np.sqrt(share)), NEAR_LIMIT) * self.scale, CLIMB_S)

    def _try_share(self, experiment: PlannedExperiment, share: float, seconds: float) -> None:
        """The first seconds at a share of the amplitude, and what full amplitude would be by them."""
        excited, cycle = set(experiment.excited), self._motion.plan.cycle_s
        cycles = min(experiment.cycles, round(seconds / cycle))
        # the fades at the ends of the excitation stand still by themselves
        fade = min(round(0.5 / cycle), cycles // 4)
        rows = ramped(experiment.torque[:cycles] * share, 0, fade)
        opening = self._motion.play(rows[:fade], fade, log=True)
        self._motion.watching.excited = excited
        body = self._motion.play(rows[fade:-fade], cycles - 2 * fade, log=True)
        self._motion.watching.excited = set()
        self._motion.watching.learn_standing(excited)
        position, time, fresh = (
            np.concatenate(parts)
            for parts in (
                (opening.position, body.position),
                (opening.time, body.time),
                (opening.fresh, body.fresh),
            )
        )
        self._motion.play(rows[-fade:], fade)
        self._motion.play(None, round(self._motion.plan.rest_s / cycle))
        for i in sorted(excited):
            limits = self._motion.config.axes[i].limits
            came = fresh[:, i]
            motion, instants = position[came, i] - self._motion.origin[i], time[came]
            travel = float(np.abs(motion).max(initial=0.0)) / share
            step = max(1, round(0.004 / cycle))
            moved = np.abs(motion[step:] - motion[:-step]) - self._motion.cell.resolution[i]
            # over the time it took: a skipped slot would pass for a leap
            velocity = float((moved / (instants[step:] - instants[:-step])).max(initial=0.0)) / share
            for what, value, limit in (
                ("travel", travel, limits.position),
                ("velocity", velocity, limits.velocity),
            ):
                if value * self.scale > NEAR_LIMIT * limit:
                    self.scale = NEAR_LIMIT * limit / value
                    self.warnings.append(
                        f"axis {self._motion.plan.axes[i]}: at full amplitude the {what} would be "
                        f"{value:.3g}, limit {limit:g}; every torque is scaled by {self.scale:.2f}"
                    )


def lowest_frequency(experiments: Sequence[PlannedExperiment]) -> float:
    """The slowest line of experiments [Hz]."""
    lines = [float(e.frequencies_hz.min()) for e in experiments if e.frequencies_hz.size]
    lines += [float(e.attributes["band_hz"][0]) for e in experiments if "band_hz" in e.attributes]
    return min(lines, default=1.0)
