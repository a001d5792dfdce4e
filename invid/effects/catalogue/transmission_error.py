"""Teeth that are not where they should be: the gear adds a sinusoid of position to the deflection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace
from invid.effects.sizes import ACCURACY_SOURCE, ARCMIN, GEAR_ERROR, Size, size
from invid.effects.supposed.law import Bounds, Shape, SinusoidLaw, SpotMotion, extent
from invid.model.place import spring_places
from invid.numerics.arrays import Float64


class TransmissionError(Effect):
    """The spring acts on d − e, e = amplitude·sin(cycles_per_rev·q + phase), q on its motor side.

    Without loss of energy the motor side feels it times 1 − ∂e/∂q.
    """

    cause = "transmission_error"
    title = "a position error of the gear (transmission error)"
    check = "Check the gear's teeth and its alignment; compensate over position."
    separating = Experiment("positions", "a slow move over a whole revolution, and a second amplitude")
    family = "position"
    stands = (spring_places,)
    looks_like = ("cogging", "encoder_eccentricity")
    home = "spring"
    over = "position"
    sizes = (Size(GEAR_ERROR, size("amplitude", 2.0), 1.5 * ARCMIN, 3 * ARCMIN, ACCURACY_SOURCE),)
    parameters: ClassVar[Mapping[str, str]] = {
        "amplitude": "position",
        "cycles_per_rev": "count",
        "phase": "angle",
    }
    main = "amplitude"

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        out: Float64 = -stiffness * p["amplitude"] * np.sin(p["cycles_per_rev"] * x + p["phase"])
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        a, b, stiffness, _ = at.spring()
        wave = at.value("amplitude"), at.value("cycles_per_rev"), at.value("phase")
        return [ForceLaw(Law.TRANSMISSION, a, b, (*wave, stiffness))]


class TransmissionErrorLaw(SinusoidLaw):
    """A sinusoid of the gear's angle in the deflection of its spring; shape ln(cycles)."""

    effect, main = TransmissionError(), "amplitude"
    shape_step = 1e-3
    LEAST, MOST = 2.0, 120.0

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        span = extent([m.angle - m.angle.mean() for m in motions], 0.98)
        return [(float(np.log(n)),) for n in np.arange(self.LEAST / span, self.MOST, max(0.35 / span, 0.25))]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        span = extent([m.angle - m.angle.mean() for m in motions], 0.98)
        return [(float(np.log(self.LEAST / span)), float(np.log(self.MOST)))]

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return self.sinusoid(motion.angle, shape)

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return super().parameters(coefficients / stiffness, shape, stiffness)
