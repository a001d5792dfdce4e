"""Make the numbers of the page's pictures: the report's, rounded, so that page and report show the same."""

from __future__ import annotations

import math
from typing import Any

from invid.model.diagnosis_document import Diagnosis
from invid.model.document import Model
from invid.recording import Recording
from invid.recording.still_axes import moving_part
from invid.report.data import figure_data

_DIGITS = 5


def plot_data(recording: Recording, model: Model, diagnosis: Diagnosis) -> dict[str, Any]:
    """Return ``figure_data`` with five significant digits (a screen shows four), no NaN."""
    recording, _ = moving_part(recording, diagnosis.model.axes)
    document: dict[str, Any] = _rounded(figure_data(recording, model, diagnosis))
    return {"axes": list(recording.axes), **document}


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _rounded(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(v) for v in value]
    if isinstance(value, float):
        return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
    return value
