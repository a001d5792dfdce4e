"""All laws that a search supposes."""

from __future__ import annotations

from invid.effects.catalogue.asymmetric_friction import AsymmetricAtMotor, InnerAsymmetric
from invid.effects.catalogue.backlash import BacklashLaw
from invid.effects.catalogue.cogging import CoggingLaw
from invid.effects.catalogue.coulomb_friction import InnerDry
from invid.effects.catalogue.cubic_stiffness import CubicStiffnessLaw
from invid.effects.catalogue.encoder_eccentricity import EncoderEccentricityLaw
from invid.effects.catalogue.gravity import GravityLaw
from invid.effects.catalogue.parameter_drift import ParameterDriftLaw
from invid.effects.catalogue.payload_change import PayloadChangeLaw
from invid.effects.catalogue.presliding_friction import InnerPresliding, PreslidingAtMotor
from invid.effects.catalogue.spring_hysteresis import SpringHysteresisLaw
from invid.effects.catalogue.stribeck_friction import InnerStribeck
from invid.effects.catalogue.torque_gain import TorqueGainLaw
from invid.effects.catalogue.torque_saturation import TorqueSaturationLaw
from invid.effects.catalogue.transmission_error import TransmissionErrorLaw
from invid.effects.catalogue.viscous_friction import InnerViscous
from invid.effects.motion_effect import MotionEffect
from invid.effects.registry import further_effects
from invid.effects.supposed.law import SupposedLaw
from invid.effects.supposed.of_effect import EffectLaw

# In the order of the search, on which a tie falls.
SUPPOSED: tuple[SupposedLaw, ...] = tuple(
    law()
    for law in (
        BacklashLaw, CubicStiffnessLaw, SpringHysteresisLaw, TransmissionErrorLaw, CoggingLaw, GravityLaw,
        EncoderEccentricityLaw, TorqueSaturationLaw, TorqueGainLaw, PayloadChangeLaw, ParameterDriftLaw,
        AsymmetricAtMotor, PreslidingAtMotor, InnerViscous, InnerDry, InnerStribeck, InnerAsymmetric,
        InnerPresliding,
    )
)  # fmt: skip
"""Those of the catalogue."""


def supposed_laws(*, linear: bool) -> tuple[SupposedLaw, ...]:
    """Those of the catalogue that a machine of such axes may have, and those of further effects."""
    further = [EffectLaw(e) for e in further_effects() if isinstance(e, MotionEffect)]
    return tuple(law for law in (*SUPPOSED, *further) if not (linear and law.effect.rotary))
