"""The shortest plan that is expected to reach its end: a stated uncertainty, or what the default plan shows.

Blocks are runs of the usual multisine, one record from rest each: all axes at once on interleaved lines. The
first is the climb of the trial, at about a third of the amplitude. After each block whoever runs the plan
looks at the measured covariance and stops as soon as it is there; blocks of reserve follow the expected ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.config import CellConfig, MultisineSpec
from invid.errors import ConfigError
from invid.planning.belief import Belief
from invid.planning.build import DEFAULT, UNKNOWN, make_plan, multisine_of
from invid.planning.detection import detection_limits
from invid.planning.expected_covariance import Expected, Noise, expected
from invid.planning.forecast import turning_back
from invid.planning.model import Plan
from invid.planning.phases import REST_S
from invid.recording.model import Role
from invid.wording.sentence import sentence

BLOCKS_S = (6.0, 8.0, 10.0, 13.0, 16.0, 20.0)
"""Lengths of a block. Shorter than 6 s the lines lie so far apart that a fit from nothing may miss a
resonance (empirical, case study: one of twelve pairs of blocks of 5 s); they scale with the lowest frequency
below 0.5 Hz."""
FROM_MODEL_S = (2.0, 2.5, 3.2, 4.0)
"""And where the fit starts at a model of the cell, which says where the resonances are."""
RUNS_S = (5.0, 6.5, 8.0)
"""Lengths of a run that are tried before that of the default plan, the longest: with it three axes take a
minute."""
UNCERTAINTY = 0.01
"""Expected relative deviation of every mass, spring and coupling after a default plan."""
MARGIN = 0.9
"""The expected uncertainty must be this much below the goal: the measured one scatters about it."""
RESERVE = 2
"""Blocks after the expected ones."""
FRICTION_FACTOR = 13.0
"""Peak torque over Coulomb torque below which sticking shows (notes, case study)."""


@dataclass(frozen=True, eq=False)
class GoalPlan:
    """A plan with what it is expected to reach."""

    plan: Plan
    goal: float
    needed: int
    """Blocks, the climb included, after which the goal is expected to be met; all of them where it is not."""
    reachable: bool
    expected: Expected
    """Expected covariance after ``needed`` blocks."""
    binding: tuple[str, ...] = ()
    """What keeps a goal from being reached."""

    @property
    def expected_s(self) -> float:
        """Robot time until the goal is expected to be met, trials of the signs apart [s]."""
        cycles = sum(e.cycles for e in self.plan.recorded[: self.needed])
        return cycles * self.plan.cycle_s + self.needed * self.plan.rest_s

    @property
    def sentence(self) -> str:
        """Return in a sentence what the plan is expected to reach, and when."""
        name, worst = self.expected.worst
        if self.reachable:
            return sentence(
                "{goal:.2g} of every mass, spring and coupling expected after {needed} of {blocks} blocks, "
                "{seconds:.0f} s (worst: {name}, {worst:.2g})",
                goal=self.goal,
                needed=self.needed,
                blocks=len(self.plan.recorded),
                seconds=self.expected_s,
                name=name,
                worst=worst,
            )
        if not np.isfinite(worst):
            return sentence(
                "{goal:.2g} is not expected: {name} is not seen by this plan at all; excite every axis",
                goal=self.goal,
                name=name,
            )
        return sentence(
            "{goal:.2g} is not expected within the limits: {name} would reach {worst:.2g} in "
            "{shaking_s:.0f} s; what binds: {names}",
            goal=self.goal,
            name=name,
            worst=worst,
            shaking_s=self.plan.shaking_s,
            names=", ".join(self.binding),
        )


@dataclass(frozen=True)
class GoalWish:
    """What a person may wish of the plan, and what it is for.

    Attributes
    ----------
    axes
        Excite only these.
    max_duration_s
        Robot time of the blocks after the climb.
    is_from_model
        Whether the fit will start at the believed plant, so that blocks may be shorter.
    """

    axes: Sequence[str] | None = None
    amplitude_scale: float = 1.0
    max_duration_s: float = 120.0
    is_from_model: bool = False


def plan_for_goal(
    config: CellConfig, belief: Belief, noise: Noise, goal: float, wish: GoalWish = GoalWish()
) -> GoalPlan:
    """The shortest plan that is expected to reach ``goal`` (relative standard deviation).

    Raises
    ------
    ConfigError
        A goal that is none, an axis that is not there, a bus over its budget.
    """
    if not 0 < goal < 1:
        raise ConfigError(f"goal is {goal:g}; give a relative uncertainty such as 1% or 0.01")
    base = multisine_of(config)
    shortest = FROM_MODEL_S if wish.is_from_model else ()
    lengths = [t * max(1.0, 0.5 / base.band_Hz[0]) for t in (*shortest, *BLOCKS_S)]
    longest = wish.max_duration_s - REST_S
    lengths = [t for t in lengths if t <= longest] or [max(longest, 1.0)]

    def plan_of(length: float, runs: int) -> Plan:
        changes = {"period_s": length, "experiments": runs, "lines": "interleaved", "seed": DEFAULT.seed}
        block = base.model_copy(update={**changes, "periods": 1, "settle_periods": 0})
        asked = config.model_copy(update={"experiments": [block]})
        made = make_plan(asked, axes=wish.axes, amplitude_scale=wish.amplitude_scale, model=belief)
        # nothing is validated: the climb counts like every block
        trials = [replace(t, experiment=replace(t.experiment, role=Role.IDENTIFY)) for t in made.trials]
        return replace(made, trials=tuple(trials))

    def reached(plan: Plan, runs: int) -> Expected:
        return expected(config, plan.recorded[: 1 + runs], belief, noise)

    runs, most = 1, 1
    for length in lengths:
        most = max(int(wish.max_duration_s // (length + REST_S)), 1)
        plan = plan_of(length, 1)
        found = reached(plan, 1)
        if found.worst[1] <= MARGIN * goal:
            break
    while MARGIN * goal < found.worst[1] < np.inf and runs < most:
        # information adds up over blocks: the number that is missing, at once
        runs = min(most, max(runs + 1, int(np.ceil(runs * (found.worst[1] / (MARGIN * goal)) ** 2))))
        plan = plan_of(length, runs)
        found = reached(plan, runs)
    reachable, needed = found.worst[1] <= goal, 1 + runs
    lowered = tuple(w for w in plan.warnings if w != UNKNOWN)
    climb = reached(plan, 0)
    if climb.worst[1] <= MARGIN * goal:
        needed, found, reachable = 1, climb, True
    if reachable and runs < most:
        plan = plan_of(length, min(runs + RESERVE, most))
    binding = lowered or (f"torque limit of {found.worst[0].split('.')[0].split('-')[0]}",)
    said = (*plan.warnings, *_friction(config, plan, belief))
    return GoalPlan(
        replace(plan, warnings=said),
        goal,
        needed,
        reachable,
        found,
        () if reachable else (*binding, f"duration of {wish.max_duration_s:g} s"),
    )


def _friction(config: CellConfig, plan: Plan, belief: Belief) -> list[str]:
    """What is said of axes that stick while they are shaken, and of figures that rest on a guess."""
    said = turning_back(config, plan.experiments[0], belief)
    creeps = plan.experiments[0].reference is not None
    for i in () if creeps else plan.excited:
        peak, coulomb = float(plan.peak_torque[i]), float(belief.coulomb[i])
        if coulomb > 0 and peak < FRICTION_FACTOR * coulomb:
            said.append(
                sentence(
                    "axis {axis}: the peak torque of {peak:.3g} is only {times:.1f} times the Coulomb "
                    "friction of {coulomb:.3g}; allow a creep_velocity in the config",
                    axis=plan.axes[i],
                    peak=peak,
                    times=peak / coulomb,
                    coulomb=coulomb,
                )
            )
    return (
        [*said, sentence("expected figures rest on {source}", source=belief.source)]
        if belief.guessed
        else said
    )


def shortest_runs(config: CellConfig, belief: Belief, noise: Noise) -> MultisineSpec:
    """The shortest runs of the default plan that are expected to tell every parameter to ``UNCERTAINTY`` and
    to show the sizes of interest; those of the default plan where none is."""
    for length in RUNS_S:
        spec = DEFAULT.model_copy(update={"period_s": length})
        plan = make_plan(config.model_copy(update={"experiments": [spec]}), model=belief)
        limits = detection_limits(config, plan.recorded, belief, noise)
        shows = all(limit.is_met for limit in limits)
        if shows and expected(config, plan, belief, noise).worst[1] <= UNCERTAINTY:
            return spec
    return DEFAULT
