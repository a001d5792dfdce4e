"""The fitted cause as a curve: what it resists with, over the quantity that it depends on.

For pictures only. The physics that is fitted and simulated stands in ``invid.effects``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.model.document import EffectTerm
from invid.numerics.arrays import Float64

VELOCITY, POSITION, DEFLECTION, TORQUE, TORQUE_RATE = (
    "velocity",
    "position",
    "deflection",
    "torque",
    "torque rate",
)

ABSCISSA = {
    "coulomb_friction": VELOCITY,
    "viscous_friction": VELOCITY,
    "stribeck_friction": VELOCITY,
    "asymmetric_friction": VELOCITY,
    "presliding_friction": POSITION,
    "torque_offset": VELOCITY,
    "cogging": POSITION,
    "gravity": POSITION,
    "encoder_eccentricity": POSITION,
    "transmission_error": POSITION,
    "cubic_stiffness": DEFLECTION,
    "quadratic_stiffness": DEFLECTION,
    "backlash": DEFLECTION,
    "spring_hysteresis": DEFLECTION,
    "spring_damping": "deflection rate",
    "coupling_stiffness": DEFLECTION,
    "torque_gain": TORQUE,
    "torque_saturation": TORQUE,
    "torque_delay": TORQUE_RATE,
    "torque_lag": TORQUE_RATE,
}
"""What each cause's missing torque is drawn over; a cause that is not here has no such picture."""


@dataclass(frozen=True)
class Curve:
    """A line to be drawn over the measured points; for hysteresis a path in time."""

    x: Float64
    y: Float64
    path: bool = False


def curve(term: EffectTerm, x: Float64, stiffness: float) -> Curve | None:
    """Resistance of ``term`` over ``x`` (a time series of its abscissa); ``None`` where it has none.

    ``stiffness`` is that of the spring the term sits in, where it sits in one.
    """
    p = {name: e.value for name, e in term.parameters.items()}
    try:
        if term.cause in ("presliding_friction", "spring_hysteresis"):
            return Curve(x, _slider(x, p["stiffness"], p["torque"]), path=True)
        grid = np.linspace(float(x.min()), float(x.max()), 241)
        y = _static(term.cause, p, grid, stiffness)
    except (KeyError, ZeroDivisionError):
        return None
    return None if y is None or not np.isfinite(y).all() else Curve(grid, y)


def _static(cause: str, p: dict[str, float], x: Float64, stiffness: float) -> Float64 | None:
    y: Float64 | None = None
    if cause == "coulomb_friction":
        y = p["torque"] * np.sign(x)
    elif cause in ("viscous_friction", "spring_damping"):
        y = p["coefficient"] * x
    elif cause == "stribeck_friction":
        near = np.exp(-((np.abs(x) / p["velocity"]) ** p.get("exponent", 2.0)))
        y = (p["coulomb"] + (p["static"] - p["coulomb"]) * near) * np.sign(x)
    elif cause == "asymmetric_friction":
        speed = p.get("low_speed_velocity", 0.0)
        near = np.exp(-((np.abs(x) / speed) ** p.get("exponent", 2.0))) if speed > 0 else np.zeros_like(x)
        up = p["coulomb_positive"] + p["viscous_positive"] * x + near * p.get("low_speed_positive", 0.0)
        down = -p["coulomb_negative"] + p["viscous_negative"] * x - near * p.get("low_speed_negative", 0.0)
        y = np.where(x > 0, up, down)
        y = y - 0.5 * (p["coulomb_positive"] - p["coulomb_negative"])
    elif cause == "torque_offset":
        y = np.full_like(x, p["torque"])
    elif cause == "cogging":
        y = p["torque"] * np.sin(p["cycles_per_rev"] * x + p["phase"])
    elif cause == "gravity":
        y = p["torque"] * np.sin(x + p["angle"])
    elif cause == "transmission_error":
        y = -stiffness * p["amplitude"] * np.sin(p["cycles_per_rev"] * x + p["phase"])
    elif cause == "cubic_stiffness":
        y = p["coefficient"] * x**3
    elif cause == "quadratic_stiffness":
        y = p["coefficient"] * x**2
    elif cause == "backlash":
        y = stiffness * (np.sign(x) * np.maximum(np.abs(x) - 0.5 * p["gap"], 0.0) - x)
    elif cause == "coupling_stiffness":
        y = p["stiffness"] * x
    elif cause == "torque_gain":
        y = (1.0 - p["gain"]) * x
    elif cause == "torque_saturation":
        y = x - np.clip(x, -p["limit"], p["limit"])
    elif cause == "torque_delay":
        y = p["delay"] * x
    elif cause == "torque_lag":
        y = p["time_constant"] * x
    return y


def _slider(x: Float64, stiffness: float, limit: float) -> Float64:
    """A spring that slides at ``limit``, along a path walked twice (the second time is drawn)."""
    most = limit / stiffness
    z, last = 0.0, float(x[0])
    out = np.empty_like(x)
    for _ in range(2):
        for k, value in enumerate(x.tolist()):
            z = min(max(z + value - last, -most), most)
            last = value
            out[k] = stiffness * z
    return out
