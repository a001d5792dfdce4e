"""An encoder disc mounted off its centre: the reading swings once a revolution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.arrays import Complex128
from invid.effects.base import Effect, Place, View, axis_places
from invid.refine.structure import ChainStructure


class EncoderEccentricity(Effect):
    """Reading = θ + amplitude·sin(θ + phase)."""

    cause = "encoder_eccentricity"
    title = "an encoder that swings once a revolution"
    check = "Check the encoder's mounting and its coupling."
    separate = "a move over a whole revolution at constant speed"
    family = "sensor"
    parameters: ClassVar[Mapping[str, str]] = {"amplitude": "position", "phase": "angle"}
    coefficients = ("sine", "cosine")
    lower, upper = (-0.5,) * 2, (0.5,) * 2
    rotary = True
    main = "amplitude"

    def places(self, structure: ChainStructure) -> list[Place]:
        return axis_places(structure)

    def _columns(self, view: View, place: Place, swing: np.ndarray) -> Complex128:
        error = view.to_lines(swing)
        out: Complex128 = -view.stiffness[:, :, place.axis][:, :, None] * error[:, None, :]
        return out

    def basis(self, view: View, place: Place, shape: Sequence[float]) -> Complex128:
        reading = view.record.motor_wave[:, place.axis]
        return self._columns(view, place, np.stack([np.sin(reading), np.cos(reading)], axis=1))

    def contribution(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[Complex128, Complex128 | None]:
        true = reading = view.record.motor_wave[:, place.axis]
        for _ in range(6):
            true = reading - x[0] * np.sin(true) - x[1] * np.cos(true)
        return self._columns(view, place, (reading - true)[:, None])[:, :, 0], None

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"amplitude": float(np.hypot(x[0], x[1])), "phase": float(np.arctan2(x[1], x[0]))}
