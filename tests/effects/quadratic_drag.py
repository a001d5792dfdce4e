"""Drag that grows with the square of the speed (fans, churned oil): f = c·v·|v|.

v is the velocity of the mass [rad/s or m/s], c the coefficient [N·m·s²/rad² or N·s²/m²].
"""

import numpy as np

from invid.effects import Experiment, MotionEffect, Parameter, mass_places


class QuadraticDrag(MotionEffect):
    """Resistance coefficient·v·|v| of one mass to ground."""

    cause, family, over = "quadratic_drag", "friction", "velocity"
    numbers = (Parameter("coefficient", "torque/velocity^2", low=0.0),)
    title = "drag that grows with the square of the speed"
    check = "Check the fan, the oil level and the seals."
    looks_like = ("viscous_friction", "coulomb_friction", "stribeck_friction")
    separating = Experiment(
        "speeds", "constant speeds in both directions: drag at three times the speed is nine times as large"
    )

    def places(self, structure):
        return mass_places(structure)

    def resistance(self, motion, shape):
        return (motion.velocity * np.abs(motion.velocity))[:, None]


EFFECT = QuadraticDrag()
