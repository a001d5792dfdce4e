"""The fitted cause as a curve for pictures: resistance over the quantity that it depends on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.effects.motion_effect import MotionEffect
from invid.effects.registry import law_of
from invid.model.document import EffectTerm
from invid.numerics.arrays import Float64

VELOCITY, POSITION, DEFLECTION, DEFLECTION_RATE = "velocity", "position", "deflection", "deflection rate"
TORQUE, TORQUE_RATE = "torque", "torque rate"


@dataclass(frozen=True)
class Curve:
    """A line to be drawn over the measured points; for hysteresis a path in time."""

    x: Float64
    y: Float64
    path: bool = False


def abscissa(term: EffectTerm) -> str | None:
    """Quantity over which a cause's missing torque is drawn; ``None`` where it has no such picture."""
    effect = law_of(term)
    return None if effect is None else effect.over or None


def across(term: EffectTerm) -> str | None:
    """Second quantity that a cause depends on; ``None`` for none."""
    effect = law_of(term)
    return effect.across or None if isinstance(effect, MotionEffect) else None


def curve(term: EffectTerm, x: Float64, stiffness: float, beside: Float64 | None = None) -> Curve | None:
    """Resistance of ``term`` over ``x`` (a time series of its abscissa); ``None`` where it has none.

    ``stiffness`` is that of the spring the term sits in, where it sits in one. ``beside`` is the time series
    of the second quantity of a law that has one.
    """
    effect = law_of(term)
    if isinstance(effect, MotionEffect) and effect.across and beside is not None:
        p = {name: e.value for name, e in term.parameters.items()}
        return Curve(x, effect.surface(p, x, beside), path=True)
    if effect is None or not effect.over:
        return None
    p = {name: e.value for name, e in term.parameters.items()}
    try:
        grid = x if effect.path else np.linspace(float(x.min()), float(x.max()), 241)
        y = effect.curve(p, grid, stiffness)
    except (KeyError, ZeroDivisionError):
        return None
    if y is None or (not effect.path and not np.isfinite(y).all()):
        return None
    return Curve(grid, y, path=effect.path)
