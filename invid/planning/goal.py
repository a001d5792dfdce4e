"""The shortest experiment that is expected to reach a stated uncertainty, in blocks.

One block is one record from rest: all axes at once on interleaved lines, crest factor low, amplitude by
frequency from ``invid.planning.blocks`` where a model is known. The first is the climb of the trial, at about
a third of the amplitude. After each block whoever runs the plan looks at the measured covariance and stops as
soon as it is there; blocks of reserve follow the expected ones.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from invid.config import CellConfig
from invid.errors import ConfigError
from invid.numerics.arrays import frozen_float
from invid.planning.belief import Belief
from invid.planning.blocks import BlockDesigner
from invid.planning.budget import require_budget
from invid.planning.build import assemble, require_known_axes
from invid.planning.expected_covariance import Expected, Noise
from invid.planning.forecast import turning_back
from invid.planning.model import Plan, PlannedExperiment
from invid.planning.phases import RECORDED_CLIMB_S, REST_S, trial_shares

BLOCKS_S = (5.0, 6.5, 8.0, 10.0, 13.0, 16.0, 20.0)
"""Lengths of a block. Shorter than 5 s the lines lie so far apart that a fit from nothing may miss a
resonance (empirical, modes of 4 to 8 Hz); they scale with the lowest frequency below 0.5 Hz."""
FROM_MODEL_S = (2.5, 3.2, 4.0)
"""And where the fit starts at a model of the cell, which says where the resonances are."""
MARGIN = 0.9
"""The expected uncertainty must be this much below the goal: the measured one scatters about it."""
HOPELESS_FACTOR = 2.0
"""Factor by which a block may be expected to miss the goal and still be computed; longer blocks resolve
more."""
RESERVE = 2
"""Blocks after the expected ones."""


@dataclass(frozen=True, eq=False)
class GoalPlan:
    """A plan with what it is expected to reach after each block."""

    plan: Plan
    goal: float
    needed: int
    """Blocks, the climb included, after which the goal is expected to be met; all of them where it is not."""
    reachable: bool
    expected: Expected
    """Expected covariance after ``needed`` blocks."""
    binding: tuple[str, ...]
    amplitudes: tuple[float, ...]
    """Share of the torque limit of each block."""

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
            return (
                f"{self.goal:.2g} of every mass, spring and coupling expected after {self.needed} of "
                f"{len(self.plan.recorded)} blocks, {self.expected_s:.0f} s (worst: {name}, {worst:.2g})"
            )
        if not np.isfinite(worst):
            return (
                f"{self.goal:.2g} is not expected: {name} is not seen by this plan at all; excite every axis"
            )
        return (
            f"{self.goal:.2g} is not expected within the limits: {name} would reach "
            f"{worst:.2g} in {self.plan.shaking_s:.0f} s; what binds: {', '.join(self.binding)}"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "goal": self.goal,
            "reachable": self.reachable,
            "blocks_needed": self.needed,
            "blocks_planned": len(self.plan.recorded),
            "expected_s": self.expected_s,
            "amplitudes": list(self.amplitudes),
            "binding": list(self.binding),
            "summary": self.sentence,
        }


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
    known = require_known_axes(config, wish.axes)
    excited = tuple(i for i, n in enumerate(known) if wish.axes is None or n in wish.axes)
    designer = BlockDesigner(config, belief, noise, excited, wish.amplitude_scale)
    max_duration_s = wish.max_duration_s
    require_budget(config)

    def plan_of(climb: PlannedExperiment, blocks: Sequence[PlannedExperiment]) -> Plan:
        return assemble(config, blocks, belief, share=wish.amplitude_scale, climb=climb)

    shortest = FROM_MODEL_S if wish.is_from_model else ()
    lengths = [t * max(1.0, 0.5 / designer.band[0]) for t in (*shortest, *BLOCKS_S)]
    lengths = [t for t in lengths if t + REST_S <= max_duration_s] or [max(max_duration_s - REST_S, 1.0)]
    best: tuple[list[PlannedExperiment], Expected] | None = None
    first = 0.0
    for length in lengths:
        # Information grows with the length: what is expected of the shortest says which ones cannot do.
        if first * np.sqrt(lengths[0] / length) > HOPELESS_FACTOR * goal and length != lengths[-1]:
            continue
        blocks = [designer.block(length, 1)]
        reached = designer.expected(blocks)
        best = (blocks, reached)
        first = first or reached.worst[1]
        if reached.worst[1] <= MARGIN * goal:
            return _complete_plan(designer, _Layout(blocks, reached, length), goal, wish, plan_of)
    blocks, reached = best if best is not None else ([], designer.expected([]))
    length = lengths[-1]
    while MARGIN * goal < reached.worst[1] < np.inf:
        # information adds up over blocks: the number that is missing, at once
        more = max(1, int(np.ceil(len(blocks) * (reached.worst[1] / (MARGIN * goal)) ** 2)) - len(blocks))
        room = int(max_duration_s // (length + REST_S)) - len(blocks)
        if min(more, room) <= 0:
            break
        blocks += [designer.block(length, 1 + len(blocks) + k) for k in range(min(more, room))]
        reached = designer.expected(blocks)
    return _complete_plan(designer, _Layout(blocks, reached, length), goal, wish, plan_of)


@dataclass(frozen=True, eq=False)
class _Layout:
    """Blocks of one length [s] at full amplitude, and what is expected of them."""

    blocks: list[PlannedExperiment]
    expected: Expected
    length: float


def _complete_plan(
    designer: BlockDesigner,
    layout: _Layout,
    goal: float,
    wish: GoalWish,
    plan_of: Callable[[PlannedExperiment, Sequence[PlannedExperiment]], Plan],
) -> GoalPlan:
    """The plan: the climb of its trial, which may be enough, the blocks, then reserve."""
    blocks, reached, length = layout.blocks, layout.expected, layout.length
    reachable = reached.worst[1] <= goal
    climb_s = max(length, RECORDED_CLIMB_S)
    if wish.is_from_model:  # which says what a block does beyond one cycle of the slowest line
        climb_s = 1.0 / designer.band[0]
    climb = designer.block(climb_s, 0)
    share = trial_shares(designer.config, climb)[1]
    first = designer.expected([replace(climb, torque=frozen_float(share * climb.torque))])
    needed = 1 + len(blocks)
    if first.worst[1] <= MARGIN * goal:
        needed, reached, reachable = 1, first, True
    for _ in range(RESERVE):
        if reachable and (len(blocks) + 1) * (length + REST_S) <= wish.max_duration_s:
            blocks = [*blocks, designer.block(length, 1 + len(blocks))]
    binding = sorted(designer.touched)
    if not reachable and np.isfinite(reached.worst[1]):
        if not binding or designer.reduced.min() > 0.99:
            name = reached.worst[0].split(".")[0].split("-")[0]
            binding.append(f"torque limit of {name}")
        binding.append(f"duration of {wish.max_duration_s:g} s")
    plan = plan_of(climb, blocks)
    return GoalPlan(
        plan=replace(
            plan,
            warnings=(
                *plan.warnings,
                *designer.warnings(),
                *turning_back(designer.config, plan.experiments[0], designer.belief),
            ),
        ),
        goal=goal,
        needed=needed,
        reachable=reachable,
        expected=reached,
        binding=tuple(binding),
        amplitudes=(share * designer.share, *(designer.share for _ in blocks)),
    )
