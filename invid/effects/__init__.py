"""The catalogue of causes, one a module."""

from invid.effects.asymmetric_friction import AsymmetricFriction
from invid.effects.backlash import Backlash
from invid.effects.base import Effect
from invid.effects.cogging import Cogging
from invid.effects.coulomb_friction import CoulombFriction
from invid.effects.coupling_stiffness import CouplingStiffness
from invid.effects.cubic_stiffness import CubicStiffness
from invid.effects.dropped_samples import DroppedSamples
from invid.effects.encoder_eccentricity import EncoderEccentricity
from invid.effects.extra_mode import ExtraMode
from invid.effects.gravity import Gravity
from invid.effects.parameter_drift import ParameterDrift
from invid.effects.payload_change import PayloadChange
from invid.effects.place import Place
from invid.effects.presliding_friction import PreslidingFriction
from invid.effects.record import Record
from invid.effects.spring_damping import SpringDamping
from invid.effects.spring_hysteresis import SpringHysteresis
from invid.effects.stribeck_friction import StribeckFriction
from invid.effects.torque_delay import TorqueDelay
from invid.effects.torque_gain import TorqueGain
from invid.effects.torque_lag import TorqueLag
from invid.effects.torque_offset import TorqueOffset
from invid.effects.torque_saturation import TorqueSaturation
from invid.effects.transmission_error import TransmissionError
from invid.effects.view import View
from invid.effects.viscous_friction import ViscousFriction

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

__all__ = ["CATALOGUE", "Effect", "Place", "Record", "View"]
