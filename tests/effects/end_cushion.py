"""A cushion that an axis runs into: a spring to ground that begins at a position, f = k·max(q − q₀, 0).

q is the position of the mass [rad or m], k the stiffness [N·m/rad or N/m], q₀ where the cushion begins.
"""

import numpy as np

from invid.effects import Experiment, MotionEffect, Parameter, mass_places


class EndCushion(MotionEffect):
    """Resistance stiffness·(q − begin) of one mass beyond a position, none before."""

    cause, family, over = "end_cushion", "position", "position"
    numbers = (
        Parameter("stiffness", "stiffness", low=0.0),
        Parameter(
            "begin",
            "position",
            linear=False,
            logarithmic=False,
            starts=(-1.0, 0.0, 0.5, 1.0, 1.5, 2.0),
        ),
    )
    title = "a cushion at one end of the travel"
    check = "Check the end stop and what has been mounted near it."
    looks_like = ("cubic_stiffness", "gravity")
    separating = Experiment("positions", "the same motion away from the end: there nothing is missing")

    def places(self, structure):
        return mass_places(structure)

    def resistance(self, motion, shape):
        return np.maximum(motion.position - shape[0], 0.0)[:, None]


EFFECT = EndCushion()
