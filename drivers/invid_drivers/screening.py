"""``screen_cell``: a record of seconds that says whether anything changed since the accepted model."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from invid.api import read_recording, screen
from invid.comparison.answers import Screening
from invid.config import CellConfig
from invid.model.document import Model
from invid.planning.belief import from_model
from invid.planning.expected_covariance import Noise
from invid.planning.screening import screening_plan
from invid.sweep import Progress
from invid_drivers.measurement import MeasurementResult, measure_to_file
from invid_drivers.stopping_budgets import Wish


@dataclass(frozen=True, eq=False)
class ScreenedCell:
    """A short measurement, and what it says of the accepted model."""

    result: MeasurementResult
    screening: Screening

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {**self.result.to_json(), "screening": self.screening.to_json()}


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
    plan = screening_plan(config, from_model(model, config), noise)
    result = measure_to_file(config, out, Wish(plan=plan), progress=progress, stop=stop)
    return ScreenedCell(result, screen(read_recording(out), model))
