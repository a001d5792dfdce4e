"""All laws that a search supposes."""

from __future__ import annotations

from invid.effects.motion_effect import MotionEffect
from invid.effects.registry import further_effects
from invid.effects.supposed.friction import (
    AsymmetricAtMotor,
    InnerAsymmetric,
    InnerDry,
    InnerPresliding,
    InnerStribeck,
    InnerViscous,
    PreslidingAtMotor,
)
from invid.effects.supposed.law import Shape, SpotMotion, SupposedLaw
from invid.effects.supposed.motors import (
    Cogging,
    EncoderEccentricity,
    Gravity,
    TorqueGain,
    TorqueSaturation,
)
from invid.effects.supposed.of_effect import EffectLaw
from invid.effects.supposed.springs import Backlash, CubicStiffness, SpringHysteresis, TransmissionError
from invid.effects.supposed.times import ParameterDrift, PayloadChange

SUPPOSED: tuple[SupposedLaw, ...] = (
    Backlash(),
    CubicStiffness(),
    SpringHysteresis(),
    TransmissionError(),
    Cogging(),
    Gravity(),
    EncoderEccentricity(),
    TorqueSaturation(),
    TorqueGain(),
    PayloadChange(),
    ParameterDrift(),
    AsymmetricAtMotor(),
    PreslidingAtMotor(),
    InnerViscous(),
    InnerDry(),
    InnerStribeck(),
    InnerAsymmetric(),
    InnerPresliding(),
)
"""Those of the catalogue."""


def supposed_laws(*, linear: bool) -> tuple[SupposedLaw, ...]:
    """Those of the catalogue that a machine of such axes may have, and those of further effects."""
    further = [EffectLaw(e) for e in further_effects() if isinstance(e, MotionEffect)]
    return tuple(law for law in (*SUPPOSED, *further) if not (linear and law.effect.rotary))


__all__ = ["SUPPOSED", "Backlash", "Shape", "SpotMotion", "SupposedLaw", "supposed_laws"]
