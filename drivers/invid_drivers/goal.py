"""``measure_to_goal``: blocks until the measured covariance reaches the goal."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from invid.config import CellConfig
from invid.errors import InputError, NotIdentifiableError
from invid.identification.identify import Masses, identify
from invid.model.document import Model, parameter_vector
from invid.planning.expected_covariance import is_in_goal, parameter_scale
from invid.planning.goal import GoalPlan
from invid.recording import Recording, read_recording
from invid.sweep import Progress
from invid_drivers.measurement import MeasurementResult, measure_to_file


@dataclass(frozen=True)
class Reached:
    """How well the records so far tell the parameters."""

    blocks: int
    worst: str
    relative: float
    """Relative standard deviation of the worst mass, spring or coupling; infinite where one is not seen."""
    trustworthy: bool
    reason: str = ""

    def meets(self, goal: float) -> bool:
        """Whether the records reach the goal, a relative standard deviation."""
        return self.trustworthy and self.relative <= goal

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "blocks": self.blocks,
            "worst": {
                "name": self.worst,
                "relative_std": self.relative if np.isfinite(self.relative) else None,
            },
            "trustworthy": self.trustworthy,
            "reason": self.reason or None,
        }


def reached(recording: Recording, masses: Masses = None) -> Reached:
    """Identify the records so far; data that carry no model yet are a reason to go on, not an error."""
    blocks = len(recording.experiments)
    try:
        model: Model = identify(recording, masses=masses)
    except (NotIdentifiableError, InputError) as error:
        return Reached(blocks, "", float("inf"), False, str(error))
    names, _ = parameter_vector(model.chains)
    if model.covariance is None:
        return Reached(blocks, "", float("inf"), False, "; ".join(model.warnings[:2]))
    place = {n: k for k, n in enumerate(model.parameter_names)}
    std = np.sqrt(np.maximum(np.diag(model.covariance), 0.0))[[place[n] for n in names]]
    relative = np.where(is_in_goal(names), std / parameter_scale(model.chains), 0.0)
    at = int(np.argmax(relative))
    trusted = bool(model.fit.get("trustworthy", True))
    reason = "" if trusted else "; ".join(model.warnings[:2])
    return Reached(blocks, names[at], float(relative[at]), trusted, reason)


def measure_to_goal(
    config: CellConfig,
    design: GoalPlan,
    out: Path,
    *,
    progress: Callable[[Progress], None] | None = None,
    stop: threading.Event | None = None,
    tell: Callable[[Reached], None] | None = None,
) -> tuple[MeasurementResult, Reached]:
    """Run the design's blocks and end as soon as the measured covariance reaches its goal.

    The identification runs in this process, not in the cycle; the axes are held meanwhile.
    """
    seen: list[Reached] = []

    def judge(recording: Recording) -> Reached:
        found = reached(recording)
        seen.append(found)
        if tell is not None:
            tell(found)
        return found

    result = measure_to_file(
        config,
        out,
        progress=progress,
        stop=stop,
        plan=design.plan,
        go_on=lambda recording: not judge(recording).meets(design.goal),
    )
    if not seen or not seen[-1].meets(design.goal):
        judge(read_recording(out))
    return result, seen[-1]
