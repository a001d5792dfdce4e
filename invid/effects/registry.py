"""The catalogue of causes, one a module."""

from invid.effects.catalogue.asymmetric_friction import AsymmetricFriction
from invid.effects.catalogue.backlash import Backlash
from invid.effects.catalogue.cogging import Cogging
from invid.effects.catalogue.coulomb_friction import CoulombFriction
from invid.effects.catalogue.coupling_stiffness import CouplingStiffness
from invid.effects.catalogue.cubic_stiffness import CubicStiffness
from invid.effects.catalogue.dropped_samples import DroppedSamples
from invid.effects.catalogue.encoder_eccentricity import EncoderEccentricity
from invid.effects.catalogue.extra_mode import ExtraMode
from invid.effects.catalogue.gravity import Gravity
from invid.effects.catalogue.parameter_drift import ParameterDrift
from invid.effects.catalogue.payload_change import PayloadChange
from invid.effects.catalogue.presliding_friction import PreslidingFriction
from invid.effects.catalogue.spring_damping import SpringDamping
from invid.effects.catalogue.spring_hysteresis import SpringHysteresis
from invid.effects.catalogue.stribeck_friction import StribeckFriction
from invid.effects.catalogue.torque_delay import TorqueDelay
from invid.effects.catalogue.torque_gain import TorqueGain
from invid.effects.catalogue.torque_lag import TorqueLag
from invid.effects.catalogue.torque_offset import TorqueOffset
from invid.effects.catalogue.torque_saturation import TorqueSaturation
from invid.effects.catalogue.transmission_error import TransmissionError
from invid.effects.catalogue.viscous_friction import ViscousFriction
from invid.effects.effect import Effect

CATALOGUE: tuple[Effect, ...] = (
    CoulombFriction(),
    ViscousFriction(),
    StribeckFriction(),
    PreslidingFriction(),
    AsymmetricFriction(),
    TorqueOffset(),
    Cogging(),
    TorqueDelay(),
    TorqueLag(),
    TorqueGain(),
    TorqueSaturation(),
    EncoderEccentricity(),
    DroppedSamples(),
    SpringDamping(),
    CubicStiffness(),
    Backlash(),
    SpringHysteresis(),
    TransmissionError(),
    Gravity(),
    ExtraMode(),
    CouplingStiffness(),
    PayloadChange(),
    ParameterDrift(),
)
"""Every cause of the contract."""
