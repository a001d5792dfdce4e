"""Trials before the full amplitude: the signs of each axis, then a tenth and a third of the shaking."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.excitation import ramped
from invid.plan.model import PlannedExperiment
from invid.recording.model import Kind
from invid.sweep.motion import Motion
from invid.sweep.sign_trial import SignTrial

NEAR_LIMIT = 0.8
"""The trial foretells the motion at full amplitude; beyond this share of a limit it is scaled down."""
TRIAL_PERIOD_S = 10.0
CLIMB_S = 4.0
"""Second step of the amplitude's trial, at the root of the first share: friction that hides motion at a
tenth of the amplitude hides less of it at a third."""


class Rehearsal:
    """What is tried before anything is recorded."""

    def __init__(
        self, motion: Motion, warnings: list[str], stated: Sequence[tuple[float, str] | None]
    ) -> None:
        self._motion = motion
        self._stated = stated
        """Inertia of each axis and who says it."""
        self.warnings = warnings
        self.scale = 1.0
        """Factor on every torque of the plan; below 1 where a limit would be near."""

    def try_signs(self, axis: int) -> None:
        """Doublets of at most a tenth of the amplitude: signs, motion, and scales against the inertia."""
        SignTrial(self._motion, axis, self._stated[axis], self.warnings).run()

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
