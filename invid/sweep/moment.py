"""Record where a sweep stood when it ended early: its phase and the last seconds of every axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from invid.numerics.arrays import Float64

TRACE_S = 2.0
"""So much is kept: a cycle of the slowest line of most plans."""
TRACE_ROWS = 200
"""Rows of the trace as told to others: enough for a picture."""


@dataclass(frozen=True, eq=False)
class Moment:
    """The last moment of a motion.

    Attributes
    ----------
    phase, axis
        What was going on, and the axis that alone was shaken in it.
    time
        (n,) seconds before the end, ≤ 0.
    position, torque
        (n, M) distance of every axis from where it stood at the start, and its measured torque.
    """

    axes: tuple[str, ...]
    phase: str
    axis: str | None
    time: Float64
    position: Float64
    torque: Float64

    def to_json(self) -> dict[str, Any]:
        """Return plain values; of a long trace evenly spaced rows, the last one among them."""
        count = len(self.time)
        kept = np.unique(np.linspace(0, count - 1, min(count, TRACE_ROWS)).round().astype(int))
        return {
            "phase": self.phase,
            "axis": self.axis,
            "trace": {
                "time_s": np.round(self.time[kept], 4).tolist(),
                **{
                    name: {a: _digits(values[kept, i]) for i, a in enumerate(self.axes)}
                    for name, values in (("position", self.position), ("torque", self.torque))
                },
            },
        }


def _digits(values: Float64) -> list[float]:
    return [float(f"{v:.5g}") for v in values]
