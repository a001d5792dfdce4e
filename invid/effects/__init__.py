"""Causes: law, look-alikes and meaning of each. What an effect in a file of its own needs is here.

>>> from invid.effects import Experiment, MotionEffect, Parameter, mass_places
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from invid.effects.effect import Effect, Experiment, PlaceMotion
    from invid.effects.elements import ForceLaw, Law, ModelPlace, StaticLaw
    from invid.effects.laws.empirical_law import spline_law, surface_law
    from invid.effects.motion_effect import MotionEffect
    from invid.effects.parameter import Parameter
    from invid.model.place import (
        axis_places,
        end_places,
        mass_places,
        motor_places,
        pair_places,
        spring_places,
    )

_HOMES = {
    "Effect": "effect",
    "Experiment": "effect",
    "ForceLaw": "elements",
    "Law": "elements",
    "ModelPlace": "elements",
    "MotionEffect": "motion_effect",
    "Parameter": "parameter",
    "PlaceMotion": "effect",
    "StaticLaw": "elements",
    "spline_law": "laws.empirical_law",
    "surface_law": "laws.empirical_law",
}
__all__ = [
    "Effect",
    "Experiment",
    "ForceLaw",
    "Law",
    "ModelPlace",
    "MotionEffect",
    "Parameter",
    "PlaceMotion",
    "StaticLaw",
    "axis_places",
    "end_places",
    "mass_places",
    "motor_places",
    "pair_places",
    "spline_law",
    "spring_places",
    "surface_law",
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'invid.effects' has no attribute {name!r}")
    home = f"invid.effects.{_HOMES[name]}" if name in _HOMES else "invid.model.place"
    return getattr(import_module(home), name)
