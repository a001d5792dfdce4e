"""``screen_cell``: a record of seconds that says whether anything changed since the accepted model."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from invid.api import read_recording, screen
from invid.comparison.answers import Screening
from invid.config import CellConfig
from invid.model.document import Model
from invid.planning.belief import Belief, from_model
from invid.planning.expected_covariance import Noise
from invid.planning.goal import GoalPlan, GoalWish, plan_for_goal
from invid.sweep import Progress
from invid_drivers.measurement import MeasurementResult, measure_to_file
from invid_drivers.stopping_budgets import Wish

SCREEN_GOAL = 0.01
"""Relative uncertainty that the record is laid out for: a change of a few per cent is then seen (a
convention)."""


@dataclass(frozen=True, eq=False)
class ScreenedCell:
    """A short measurement, and what it says of the accepted model."""

    result: MeasurementResult
    screening: Screening

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {**self.result.to_json(), "screening": self.screening.to_json()}


def screening_plan(
    config: CellConfig, belief: Belief, noise: Noise, *, amplitude_scale: float = 1.0
) -> GoalPlan:
    """The plan of a screening: the blocks that its goal needs, at least two, on all axes, without reserve."""
    wish = GoalWish(amplitude_scale=amplitude_scale, is_from_model=True)
    design = plan_for_goal(config, belief, noise, SCREEN_GOAL, wish)
    # the climb alone is too weak to tell which of two coupled axes changed
    needed = max(design.needed, 2)
    plan = design.plan.first(needed - 1)
    return replace(design, plan=plan, needed=needed)


def screen_cell(
    config: CellConfig,
    model: Model,
    out: Path,
    *,
    noise: Noise,
    progress: Callable[[Progress], None] | None = None,
    stop: threading.Event | None = None,
) -> ScreenedCell:
    """Measure for seconds and compare with the accepted model."""
    design = screening_plan(config, from_model(model, config), noise)
    result = measure_to_file(config, out, Wish(plan=design.plan), progress=progress, stop=stop)
    return ScreenedCell(result, screen(read_recording(out), model))
