"""An encoder disc mounted off its centre: the reading swings once a revolution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ModelPlace, ReadingError
from invid.effects.laws.ripple_cycles import rotate_phase
from invid.effects.motion import View
from invid.effects.sizes import ARCSEC, ENCODER_SOURCE, READING, Size, size
from invid.model.parameters import ChainStructure
from invid.model.place import Place, axis_places
from invid.numerics.arrays import Complex128, Float64


class EncoderEccentricity(Effect):
    """Reading = θ + amplitude·sin(θ + phase)."""

    cause = "encoder_eccentricity"
    title = "an encoder that swings once a revolution"
    check = "Check the encoder's mounting and its coupling."
    separating = Experiment("positions", "a move over a whole revolution at constant speed")
    family = "sensor"
    looks_like = ("cogging", "transmission_error")
    home = "axis"
    over = "position"
    sizes = (Size(READING, size("amplitude"), 65 * ARCSEC, 130 * ARCSEC, ENCODER_SOURCE),)
    parameters: ClassVar[Mapping[str, str]] = {"amplitude": "position", "phase": "angle"}
    coefficients = ("sine", "cosine")
    lower, upper = (-0.5,) * 2, (0.5,) * 2
    rotary = True
    main = "amplitude"

    def places(self, structure: ChainStructure) -> list[Place]:
        return axis_places(structure)

    def _error_lines(self, view: View, place: Place, swing: Float64) -> Complex128:
        """(F, L) lines of the reading's errors (n, L) over time.

        The part proportional to the reading is taken from the measured lines with their noise: the wave has
        none on lines below the noise, so an error of scale would change the size of the motion and not of its
        noise.
        """
        wave = view.record.motor_wave[:, place.axis]
        centred = wave - wave.mean()
        power = float(centred @ centred)
        scale: Float64 = centred @ swing / power if power > 0 else np.zeros(swing.shape[1])
        error = view.to_lines(swing - wave[:, None] * scale)
        return error + view.record.position[:, place.axis, None] * scale

    def basis(self, view: View, place: Place, shape: Sequence[float]) -> Complex128:
        reading = view.record.motor_wave[:, place.axis]
        error = self._error_lines(view, place, np.stack([np.sin(reading), np.cos(reading)], axis=1))
        out: Complex128 = -view.stiffness[:, :, place.axis][:, :, None] * error[:, None, :]
        return out

    def contribution(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[Complex128, Complex128 | None]:
        def lines() -> Complex128:
            reading = view.record.motor_wave[:, place.axis]
            return self._error_lines(view, place, (reading - _true_position(reading, x))[:, None])

        error = view.cached((self, place, tuple(x)), lines)  # no inner motion changes it
        # Every coordinate moves as the motor does, not as it reads.
        return -view.stiffness[:, :, place.axis] * error, -view.motion[:, :, place.axis] * error

    def noise_power(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[float | Float64, float | Float64]:
        true = _true_position(view.record.motor_wave[:, place.axis], x)
        # d(true)/d(reading): on a small motion the swing is a scale of the encoder, of its noise as well.
        return float(np.mean((1.0 + x[0] * np.cos(true) - x[1] * np.sin(true)) ** -2)), 1.0

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {"amplitude": float(np.hypot(x[0], x[1])), "phase": float(np.arctan2(x[1], x[0]))}

    def vector(self, p: Mapping[str, float]) -> list[float]:
        return [*rotate_phase(p["amplitude"], p["phase"])]

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [ReadingError(at.axis, at.value("amplitude"), at.value("phase"))]


def _true_position(reading: Float64, x: Sequence[float]) -> Float64:
    """(n,) true position behind a reading."""
    true = reading
    for _ in range(6):
        true = reading - x[0] * np.sin(true) - x[1] * np.cos(true)
    return true
