"""The torque that acts is cut off at a limit that the record does not show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.arrays import Complex128
from invid.effects.base import Effect
from invid.effects.place import Place, axis_places
from invid.effects.view import View
from invid.refine.structure import ChainStructure

CUTS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.78, 0.85, 0.9, 0.94, 0.97)
"""Limits to start from over the peak torque: closer at the top, where a little more cuts nothing any more."""


class TorqueSaturation(Effect):
    """Acting torque = recorded torque within ±limit."""

    cause = "torque_saturation"
    title = "torque that is cut off at a limit"
    check = "Check the drive's current and torque limits and its bus voltage."
    separate = "a second amplitude: below the limit nothing is missing"
    family = "saturation"
    parameters: ClassVar[Mapping[str, str]] = {"limit": "torque"}
    shapes, logarithmic = ("limit",), (True,)
    main = "limit"

    def places(self, structure: ChainStructure) -> list[Place]:
        return axis_places(structure)

    def _peak(self, views: Sequence[View], place: Place) -> float:
        return max(float(np.abs(v.record.torque_wave[:, place.axis]).max()) for v in views)

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        peak = max(self._peak(views, place), 1e-300)
        return [(float(np.log(peak * f)),) for f in CUTS]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        peak = max(self._peak(views, place), 1e-300)
        # Cut below a tenth of its peak a torque is no measurement of itself any more, and the fit could
        # shrink plant and torque together until noise covers both.
        return [(float(np.log(0.1 * peak)), float(np.log(0.995 * peak)))]

    def contribution(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[Complex128, Complex128 | None]:
        limit = float(np.exp(x[0]))
        t = view.record.torque_wave[:, place.axis]
        cut = view.to_lines((t - np.clip(t, -limit, limit))[:, None])[:, 0]
        out: Complex128 = np.zeros_like(view.acting)
        ratio = view.acting[:, place.axis] / np.where(
            np.abs(view.record.torque[:, place.axis]) > 0, view.record.torque[:, place.axis], 1.0
        )
        ratio = np.where(np.abs(view.record.torque[:, place.axis]) > 0, ratio, 1.0)
        out[:, place.axis] = cut * ratio
        return out, None

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"limit": float(np.exp(x[0]))}
