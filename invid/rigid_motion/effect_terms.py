"""Terms of a fit as the contract's effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.effects.effect import Effect
from invid.effects.registry import BY_CAUSE
from invid.effects.units import unit_of
from invid.model.document import EffectTerm, Estimate
from invid.model.place import Place
from invid.numerics.arrays import Float64
from invid.rigid_motion.analysis import Analysis
from invid.rigid_motion.regression import fit_terms
from invid.rigid_motion.regressors import Regressor


def term_of(analysis: Analysis, term: Regressor) -> EffectTerm:
    """The contract's cause and parameters, with one standard deviation each."""
    final, linear = analysis.final, analysis.recording.linear
    effect = term.law or BY_CAUSE[term.cause]
    value, std = final.of(term)
    place = Place("mass", term.axis, 1)
    count = len(effect.coefficients)
    shapes = [] if term.shape is None or not effect.shapes else [_fit_value(effect, term.shape)]

    def sizes(x: Float64) -> dict[str, float]:
        return effect.values([*x.tolist(), *shapes], place)

    start = sum(len(t.names) for t in final.terms[: final.terms.index(term)])
    spread = final.covariance[start : start + count, start : start + count]
    if term.held:  # how well a coefficient at its bound is known: as well as without the bound
        free = replace(term, held=())
        _, loose = fit_terms(analysis.design, [free if t is term else t for t in final.terms]).of(free)
        at = [term.names.index(n) for n in term.held if n in term.names[:count]]
        spread, std = spread.copy(), std.copy()
        spread[at, at], std[at] = loose[at] ** 2, loose[at]
    step = np.where(std[:count] > 0, std[:count], 1.0) * 1e-3
    shifted = [
        {n: (up[n] - backward[n]) / (2 * h) for n in up}
        for h, up, backward in (
            (h, sizes(value[:count] + h * e), sizes(value[:count] - h * e))
            for h, e in zip(step, np.eye(count), strict=True)
        )
    ]
    parameters: dict[str, Estimate] = {}
    for name, size in sizes(value[:count]).items():
        slope = np.array([m[name] for m in shifted])
        unit = unit_of(effect.parameters[name], linear)
        own = float(np.sqrt(max(slope @ spread @ slope, 0.0)))
        parameters[name] = Estimate(size, own, None if unit == "1" else unit)
    force, speed = unit_of("torque", linear), unit_of("velocity", linear)
    for k in range(count, len(term.names)):  # how it bends at low speed, which the cause's own do not say
        parameters[term.names[k]] = Estimate(float(value[k]), float(std[k]), force)
    if term.shape is not None:
        low_speed = effect.shapes[0] if effect.shapes else "low_speed_velocity"
        parameters[low_speed] = _shape_estimate(
            analysis, term, parameters[low_speed].unit if effect.shapes else speed
        )
    if term.exponent or "inertia_counts" in effect.parameters:
        power = "inertia_counts" if "inertia_counts" in effect.parameters else "exponent"
        parameters[power] = Estimate(float(term.exponent), 0.0, None)  # tried, not fitted
    axis, element, other = place_of(term, analysis.recording.axes)
    table = effect.table(value[:count], spread, linear=linear)
    return EffectTerm(term.cause, axis, parameters, element, other, table)


def place_of(term: Regressor, axes: Sequence[str]) -> tuple[str, str | None, str | None]:
    """Axis, element and other axis of a term, as the contract names them."""
    element = {"axis": None, "spring": "spring 0"}.get(BY_CAUSE[term.cause].home, "mass 1")
    return axes[term.axis], element, None if term.other is None else axes[term.other]


def _fit_value(effect: Effect, shape: float) -> float:
    """A shape parameter as it is fitted."""
    return float(np.log(shape)) if effect.logarithmic[0] else shape


def _shape_estimate(analysis: Analysis, term: Regressor, unit: str | None) -> Estimate:
    spread = analysis.shape_std.get(term, np.inf)
    return Estimate(float(term.shape or 0.0), float(spread) if np.isfinite(spread) else None, unit)
