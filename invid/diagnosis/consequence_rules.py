"""From which size on a cause matters: published figures for geared servo axes, as a table.

A row holds for one cause and one measure (``consequence_measures``). Up to ``expected`` the finding is what
such drives are like; from ``serious`` on somebody should look. Where the config gives a limit of its own
(``acceptable``), that counts instead. A cause without a row has no figure to judge it by.

Angles are those at the output of the gear. Publications are for rotary robot axes; rows with ``linear`` hold
by physics for both kinds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

ARCMIN = math.pi / 180 / 60
"""One minute of arc [rad]."""
ARCSEC = ARCMIN / 60

_JOINT = (
    "friction of an industrial robot's joint, 3 to 15 % of its largest torque "
    "(Bittencourt and Gunnarsson, J. Dyn. Syst. Meas. Control 134, 2012, 051013)"
)
_PLAY = (
    "1′ of cycloidal robot gears (Nabtesco RV), 3′ of standard servo planetary gears (Wittenstein glossary)"
)
_HYSTERESIS = "hysteresis loss of strain-wave gears, up to 2′ (Harmonic Drive CSF and CSG, p. 49)"
_ACCURACY = "positional accuracy of strain-wave gearheads, 1 to 1.5′ (Harmonic Drive SHD)"
_ENCODER = "accuracy of motor encoders, ±20″ optical, ±65″ inductive (Heidenhain, Encoders for Servo Drives)"
_COGGING = "cogging of servo motors, ±1 to ±2 % of rated torque (Kollmorgen, Synchronism)"
_CONSTANT = "tolerance of a servo motor's torque constant, ±10 % (Kollmorgen AKM)"
_STIFFENING = (
    "rise of a strain-wave gear's stiffness up to rated torque, K3/K1 of about 2 (Harmonic Drive CSF)"
)
_RATED = "rated torque is what the motor can give for ever (IEC 60034-1, duty S1)"


@dataclass(frozen=True)
class Rule:
    """Sizes of one measure of one cause: usual up to ``expected``, serious from ``serious`` on."""

    cause: str
    measure: str
    expected: float
    serious: float
    source: str
    linear: bool = False


RULES: tuple[Rule, ...] = (
    Rule("coulomb_friction", "friction_fraction_of_rated", 0.15, 0.30, _JOINT),
    Rule("viscous_friction", "friction_at_speed_fraction_of_rated", 0.15, 0.30, _JOINT),
    Rule("stribeck_friction", "friction_fraction_of_rated", 0.15, 0.30, _JOINT),
    Rule("presliding_friction", "friction_fraction_of_rated", 0.15, 0.30, _JOINT),
    Rule("asymmetric_friction", "friction_fraction_of_rated", 0.15, 0.30, _JOINT),
    Rule("backlash", "backlash", 1 * ARCMIN, 3 * ARCMIN, _PLAY),
    Rule("spring_hysteresis", "lost_motion", 2 * ARCMIN, 4 * ARCMIN, _HYSTERESIS),
    Rule("transmission_error", "transmission_error", 1.5 * ARCMIN, 3 * ARCMIN, _ACCURACY),
    Rule("encoder_eccentricity", "encoder_error", 65 * ARCSEC, 130 * ARCSEC, _ENCODER),
    Rule("cogging", "torque_ripple_fraction_of_rated", 0.02, 0.04, _COGGING),
    Rule("torque_gain", "torque_gain_error_fraction", 0.10, 0.20, _CONSTANT),
    Rule("cubic_stiffness", "stiffening_fraction", 1.0, 2.0, _STIFFENING),
    Rule("gravity", "gravity_fraction_of_rated", 1.0, 1.0, _RATED, linear=True),
    Rule("torque_saturation", "torque_shortfall_fraction_of_rated", 0.0, 0.0, _RATED, linear=True),
)
"""Where a source gives a range, its upper end is usual and twice that is serious (a convention), unless the
source has another class of drives above it."""

BY_CAUSE: dict[str, tuple[Rule, ...]] = {
    cause: tuple(r for r in RULES if r.cause == cause) for cause in dict.fromkeys(r.cause for r in RULES)
}
