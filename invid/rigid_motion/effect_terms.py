"""Causes of a fit as the contract's effects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.catalogue.asymmetric_friction import AsymmetricAtMotor
from invid.effects.registry import BY_CAUSE
from invid.effects.supposed.of_effect import SmoothLaw
from invid.effects.units import unit_of
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.model.document import EffectTerm, Estimate
from invid.numerics.arrays import Float64
from invid.rigid_motion.fit import Fit, joint_covariance
from invid.rigid_motion.rows import Rows
from invid.rigid_motion.search import Cause
from invid.rigid_motion.terms import BEND, BY_DIRECTION, HELD, PRESLIDING, RISE, Base, Term

STEP = 1e-3
"""Step of a derivative over its deviation (numerical)."""


def effect_of_cause(rows: Rows, final: Fit, cause: Cause, axes: Sequence[str], *, linear: bool) -> EffectTerm:
    """The contract's cause and parameters, with one standard deviation each."""
    covariance, shaped = joint_covariance(rows, final)
    at = [i for t in cause.terms for i in range(*final.span(t).indices(final.value.size))]
    at += [final.value.size + shaped.index(t) for t in cause.terms if t.shape]
    x = np.concatenate([*(final.of(t)[0] for t in cause.terms), [t.shape[0] for t in cause.terms if t.shape]])
    spread = covariance[np.ix_(at, at)]
    steps = STEP * np.where(np.diag(spread) > 0, np.sqrt(np.abs(np.diag(spread))), 1.0)
    slopes = [
        {n: (up - down[n]) / (2 * h) for n, up in _sizes(cause, x + h * e).items()}
        for h, e in zip(steps, np.eye(x.size), strict=True)
        for down in (_sizes(cause, x - h * e),)
    ]
    parameters = {}
    for name, size in _sizes(cause, x).items():
        slope = np.array([s[name] for s in slopes])
        usual = "velocity" if name.endswith("velocity") else "torque"
        kind = BY_CAUSE[cause.name].parameters.get(name, usual)
        unit = "1" if name in ("exponent", "inertia_counts") else unit_of(kind, linear)
        std = float(np.sqrt(max(slope @ spread @ slope, 0.0)))
        parameters[name] = Estimate(size, std, None if unit == "1" else unit)
    law = cause.terms[0].law
    table = None
    if isinstance(law, SmoothLaw):
        table = law.law.table(x, spread, linear=linear)
    axis, element, other = place_of(cause.terms[0], axes)
    return EffectTerm(cause.name, axis, parameters, element, other, table)


def _sizes(cause: Cause, x: Float64) -> dict[str, float]:
    """Parameters from the coefficients of all terms of a cause, then their first shapes."""
    values, at, last = {}, 0, sum(len(t.low) for t in cause.terms)
    shapes: dict[object, tuple[float, ...]] = {}
    for term in cause.terms:
        values[term.law] = x[at : at + len(term.low)]
        at += len(term.low)
        if term.shape:
            shapes[term.law], last = (float(x[last]), *term.shape[1:]), last + 1
    head, none = cause.terms[0], np.zeros(1)
    dry, viscous, offset = (float(values.get(p, none)[0]) for p in (Part.DRY, Part.VISCOUS, Part.OFFSET))
    if BEND in values or BY_DIRECTION in values:
        even = float(values.get(BY_DIRECTION, none)[0])
        out = AsymmetricAtMotor().parameters(np.array([even, dry, viscous, offset]), (), 1.0)
        if BEND in values:
            both, more = (float(v) for v in values[BEND])
            out |= {"low_speed_positive": both + more, "low_speed_negative": both - more}
            out |= _bend(shapes[BEND], "low_speed_velocity")
        return out
    if head.law is RISE:
        out = {"static": dry + float(values[RISE][0]), "coulomb": dry}
        return out | _bend(shapes[RISE], "velocity")
    if head.law is PRESLIDING:
        out = PRESLIDING.parameters(values[PRESLIDING], shapes[PRESLIDING], 1.0)
        return out | {"torque": out["torque"] + float(values.get(HELD, none)[0])}
    if isinstance(head.law, Part | Base):
        return {BY_CAUSE[cause.name].main: float(x[0])}
    return head.law.parameters(values[head.law], shapes.get(head.law, ()), 1.0)


def _bend(shape: tuple[float, ...], name: str) -> dict[str, float]:
    return {name: float(np.exp(shape[0])), "exponent": shape[1]}


def place_of(term: Term, axes: Sequence[str]) -> tuple[str, str | None, str | None]:
    """Axis, element and other axis of a term, as the contract names them."""
    element = {"axis": None, "spring": "spring 0"}.get(BY_CAUSE[term.cause].home, "mass 1")
    return axes[term.axis], element, None if term.other is None else axes[term.other]
