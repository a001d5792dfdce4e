"""An encoder disc mounted off its centre: the reading swings once a revolution."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ModelPlace, ReadingError
from invid.effects.sizes import ARCSEC, ENCODER_SOURCE, READING, Size, size
from invid.effects.supposed.law import Bounds, Shape, SinusoidLaw, SpotMotion
from invid.model.place import axis_places
from invid.numerics.arrays import Float64


class EncoderEccentricity(Effect):
    """Reading = θ + amplitude·sin(θ + phase)."""

    cause = "encoder_eccentricity"
    title = "an encoder that swings once a revolution"
    check = "Check the encoder's mounting and its coupling."
    separating = Experiment("positions", "a move over a whole revolution at constant speed")
    family = "sensor"
    stands = (axis_places,)
    looks_like = ("cogging", "transmission_error")
    home = "axis"
    over = "position"
    sizes = (Size(READING, size("amplitude"), 65 * ARCSEC, 130 * ARCSEC, ENCODER_SOURCE),)
    parameters: ClassVar[Mapping[str, str]] = {"amplitude": "position", "phase": "angle"}
    rotary = True
    main = "amplitude"

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [ReadingError(at.axis, at.value("amplitude"), at.value("phase"))]


class EncoderEccentricityLaw(SinusoidLaw):
    """An encoder that reads θ + amplitude·sin(θ + phase); its motor stands at the reading less that."""

    effect, main = EncoderEccentricity(), "amplitude"
    reads = True

    def limits(self, motions: Sequence[SpotMotion]) -> Bounds:
        return [(-0.5, 0.5), (-0.5, 0.5)]

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        return -super().waves(motion, shape)
