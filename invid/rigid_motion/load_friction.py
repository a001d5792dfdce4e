"""Friction that grows with the load: coefficient·|load|·sign(v).

The load is the torque that the rest of the model asks of the joint: its weight alone, or weight and inertia
(what a gear or a screw hands on; Hamon, Gautier, Garrec, "Dynamic identification of robots with a dry
friction model depending on load and velocity", ICRA 2010). It is known only once the rest is fitted, so the
coefficient is found in turns with it. Where the load hardly varies, such friction is Coulomb friction.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.numerics.arrays import Float64
from invid.rigid_motion.regression import Design, Fit, fit_terms
from invid.rigid_motion.regressors import Regressor, load_on

CAUSE = "load_dependent_friction"
LEAST_VARIATION = 0.1
"""Spread of |load| over its mean below which it counts as constant. Physical: |load|·sign(v) is then Coulomb
friction to a tenth, which a cause that must explain a tenth of the residual cannot be told from."""
_WEIGHT = ("gravity",)
_WHOLE = ("gravity", "inertia", "coupling", "configuration", "torque_offset")
_ROUNDS, _SETTLED = 8, 1e-4


def load_terms(current: Fit, design: Design) -> list[Regressor]:
    """The cause on every axis whose load varies: under the weight alone, and under weight and inertia."""
    found = []
    for axis in range(design.axes):
        for exponent, causes in ((0, _WEIGHT), (1, _WHOLE)):
            term = _load_term(current, axis, causes, exponent)
            if term is not None and load_variation(design, term) > LEAST_VARIATION:
                found.append(term)
    return found


def _load_term(current: Fit, axis: int, causes: tuple[str, ...], exponent: int) -> Regressor | None:
    acting = [t for t in current.terms if t.cause in causes and axis in (t.axis, t.other)]
    if not acting:
        return None
    load = tuple((t, tuple(float(v) for v in current.of(t)[0])) for t in acting)
    return Regressor(CAUSE, axis, ("coefficient",), ("coefficient",), exponent=exponent, load=load)


def load_variation(design: Design, term: Regressor) -> float:
    """Spread of |load| over its mean, over the rows' motion; 0 where constant velocity shows one load."""
    sizes = np.concatenate([np.abs(load_on(term, m)) for m in design.motions])
    moving = np.concatenate([np.abs(m.velocity[:, term.axis]) > m.rest[term.axis] for m in design.motions])
    if moving.sum() < 2:
        return 0.0
    mean = float(sizes[moving].mean())
    return float(sizes[moving].std()) / mean if mean > 0 else 0.0


def fix_loads(design: Design, terms: list[Regressor]) -> list[Regressor]:
    """The terms with every load computed from the fit beside it, iterated."""
    if not any(t.cause == CAUSE for t in terms):
        return terms
    before: Float64 | None = None
    for _ in range(_ROUNDS):
        current = fit_terms(design, terms)
        if before is not None and np.allclose(current.value, before, rtol=_SETTLED):
            break
        before = current.value
        terms = [_with_current_load(t, current) for t in terms]
    return terms


def _with_current_load(term: Regressor, current: Fit) -> Regressor:
    if term.cause != CAUSE:
        return term
    fresh = _load_term(current, term.axis, _WHOLE if term.exponent else _WEIGHT, term.exponent)
    return term if fresh is None else replace(term, load=fresh.load)
