"""Terms of a fit as the contract's effects, and the experiments that would tell rivals apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from invid.model.document import EffectTerm, Estimate
from invid.rigid_motion.analysis import Analysis
from invid.rigid_motion.regressors import Term

_FRICTION = {"viscous_friction", "coulomb_friction", "stribeck_friction", "asymmetric_friction"}
_LOADED = "load_dependent_friction"


def effect_of(analysis: Analysis, term: Term) -> EffectTerm:
    """The contract's cause and parameters, with one standard deviation each."""
    value, std = analysis.final.of(term)
    linear = analysis.recording.linear
    force, length = ("N", "m") if linear else ("N·m", "rad")
    rate = f"{force}·s/{length}"
    axis = analysis.recording.axes[term.axis]
    other = None if term.other is None else analysis.recording.axes[term.other]
    at = dict(zip(term.names, zip(value.tolist(), std.tolist(), strict=True), strict=True))
    parameters: dict[str, Estimate] = {}
    element: str | None = "mass 1"
    match term.cause:
        case "stribeck_friction":
            start = sum(len(t.names) for t in analysis.final.terms[: analysis.final.terms.index(term)])
            both = analysis.final.covariance[start : start + 2, start : start + 2]
            parameters["static"] = Estimate(float(value.sum()), float(np.sqrt(both.sum())), force)
            parameters["coulomb"] = Estimate(*at["coulomb"], force)
            parameters["velocity"] = _shape(analysis, term, f"{length}/s")
            parameters["exponent"] = Estimate(float(term.exponent), None, None)
        case "asymmetric_friction":
            for name, pair in at.items():
                parameters[name] = Estimate(*pair, rate if name.startswith("viscous") else force)
            if term.shape is not None:
                parameters["low_speed_velocity"] = _shape(analysis, term, f"{length}/s")
                parameters["exponent"] = Estimate(float(term.exponent), None, None)
        case "gravity":
            sine, cosine = value
            size = float(np.hypot(sine, cosine))
            parameters["torque"] = Estimate(
                size, float(np.hypot(sine * std[0], cosine * std[1]) / size), force
            )
            angle = float(np.hypot(cosine * std[0], sine * std[1]) / size**2)
            parameters["angle"] = Estimate(float(np.arctan2(cosine, sine)), angle, "rad")
        case "load_dependent_friction":
            parameters["coefficient"] = Estimate(*at["coefficient"], None)
            parameters["inertia_counts"] = Estimate(float(term.exponent), None, None)
        case "viscous_friction":
            parameters["coefficient"] = Estimate(*at["coefficient"], rate)
        case "torque_delay":
            element = None
            parameters["delay"] = Estimate(*at["delay"], "s")
        case "cubic_stiffness" | "quadratic_stiffness":
            element = "spring 0"
            power = {"quadratic_stiffness": 2, "cubic_stiffness": 3}[term.cause]
            parameters["coefficient"] = Estimate(*at["coefficient"], f"{force}/{length}^{power}")
        case _:
            parameters["torque"] = Estimate(*at["torque"], force)
    return EffectTerm(term.cause, axis, parameters, element, other)


def _shape(analysis: Analysis, term: Term, unit: str) -> Estimate:
    spread = analysis.shape_std.get(term, np.inf)
    return Estimate(float(term.shape or 0.0), float(spread) if np.isfinite(spread) else None, unit)


def separating(axis: str, causes: set[str], speed: float, linear: bool) -> Mapping[str, Any] | None:
    """The experiment that would tell ``causes`` on ``axis`` apart."""
    unit = "m/s" if linear else "rad/s"
    if _LOADED in causes:
        return {
            "kind": "other",
            "axis": axis,
            "text": f"repeat the motion of {axis} with another payload: friction that depends on the load "
            "changes with it, other friction does not",
        }
    if len(causes & _FRICTION) > 1 or (causes & _FRICTION and "torque_offset" in causes):
        ladder = [round(speed * f, 6) for f in (0.01, 0.03, 0.1, 0.3, 1.0)]
        return {
            "kind": "constant_velocity",
            "axis": axis,
            "speeds": ladder,
            "unit": unit,
            "directions": [1, -1],
            "text": f"move {axis} at constant speeds of {ladder} {unit} in both directions",
        }
    if causes & {"gravity", "torque_offset", "ground_spring"}:
        return {
            "kind": "other",
            "axis": axis,
            "text": f"move {axis} slowly through as much of its range as it has, in both directions",
        }
    if causes & {"cubic_stiffness", "quadratic_stiffness"}:
        return {
            "kind": "multisine",
            "axis": axis,
            "amplitude_scale": [0.3, 1.0],
            "text": f"excite {axis} at two amplitudes a factor of three apart",
        }
    return {"kind": "other", "axis": axis, "text": f"repeat the motion of {axis} at another speed and load"}
