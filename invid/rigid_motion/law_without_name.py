"""What no cause explains on an axis of one rigid mass: a smooth law over its velocity, position or both."""

from __future__ import annotations

import numpy as np

from invid.effects.laws.empirical_law import (
    NAMELESS,
    EmpiricalLaw,
    is_known,
    is_like_law,
    knots_of,
    most_knots,
)
from invid.effects.motion_effect import OF_RATE
from invid.effects.registry import BY_CAUSE
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.numerics.smooth_parts import smooth_parts
from invid.rigid_motion.regression import Design, Fit, fit_terms, noise_of
from invid.rigid_motion.regressors import Regressor
from invid.rigid_motion.selection import (
    FALSE_ALARM,
    SIGNIFICANT,
    axes_at_noise,
    held_out_cost,
    held_out_p,
    information_criterion,
    judged_rows,
    training_p,
)

COUNTS, MORE_OF_TWO = (1, 2, 3, 5, 8, 12, 20), (32, 50, 80)
"""Numbers of its smoothest shapes that are tried, and more of a law over two quantities; pieces kept out
in turn say which is best."""
DRY = ("coulomb_friction", "stribeck_friction", "asymmetric_friction")
"""Causes that jump where the motion reverses."""
NEARLY_ALL = 0.98
"""Share of what is missing on its axis in rows kept out that a law must take where it does not reach the
noise."""


def add_laws(design: Design, current: Fit) -> Fit:
    """The fit with a law on every axis where causes leave something and one law takes nearly all of it."""
    for axis in np.flatnonzero(~axes_at_noise(design, current)):
        if budget.is_left_out("a law without a name"):
            break
        curves = [t for q in ("velocity", "position") for t in _trials(design, current, int(axis), q, "")]
        tried, accepted = len(curves), _accepted(design, current, curves, int(axis), len(curves))
        if not accepted:
            surfaces = _trials(design, current, int(axis), "velocity", "position")
            tried += len(surfaces)
            accepted = [
                f
                for f in _accepted(design, current, surfaces, int(axis), tried)
                if all(held_out_p(design, curve, f) <= FALSE_ALARM for curve in curves)
            ]
        rows = current.effective
        current = min(accepted, key=lambda f: information_criterion(f, rows), default=current)
    return current


def _trials(design: Design, current: Fit, axis: int, over: str, across: str) -> list[Fit]:
    """The fits with a law over one quantity or two, where that moves, beside the terms that may be there."""
    fits = (
        _with_law(design, fit_terms(design, terms), axis, over, across)
        for terms in _beside_law(current.terms, axis, over)
    )
    return [f for f in fits if f is not None]


def _accepted(design: Design, current: Fit, trials: list[Fit], axis: int, tried: int) -> list[Fit]:
    return [f for f in trials if _is_accepted(design, current, f, axis, tried)]


def _beside_law(terms: list[Regressor], axis: int, over: str) -> list[list[Regressor]]:
    """The terms without the causes of an axis that may stand for a part of a law ``over`` a quantity.

    Of friction the dry part may be there beside the law, which does not jump. The instant of the torque is
    fitted again: without the law it may have been lost.
    """
    kept = [t for t in terms if t.axis != axis or t.base or not is_like_law(BY_CAUSE[t.cause], over)]
    offset = Regressor("time_offset", axis, ("delay",), base=True)
    moves = any(t.cause == "inertia" and t.axis == axis for t in kept)
    if moves and not any(t.label == offset.label or t.cause == "torque_delay" for t in kept):
        kept.append(offset)
    dry = Regressor("coulomb_friction", axis, ("torque",), ("torque",))
    jumps = over in OF_RATE and any(t.axis == axis and t.cause in DRY for t in terms)
    return [kept, [*kept, dry]] if jumps else [kept]


def _with_law(design: Design, current: Fit, axis: int, over: str, across: str) -> Fit | None:
    """The fit with a law over one quantity or two beside all terms; ``None`` where one does not move."""
    knots = []
    for q in (over, across) if across else (over,):
        quantity = [m.rows(m.velocity if q in OF_RATE else m.position) for m in design.motions]
        seen = design.on_axis(quantity, axis)[design.train[design.axis == axis]]
        own = knots_of([seen], most_knots(q, two=bool(across)))
        if own is None:
            return None
        knots.append(own)
    first, second = knots[0], knots[1] if across else [0.0]

    def law_of(shapes: Float64) -> EmpiricalLaw:
        return EmpiricalLaw(over, first, shapes, across, second)

    rows, weight = design.train, design.weight[design.train, None]
    known = np.linalg.qr(design.matrix(current.terms)[rows] * weight)[0]
    columns = design.columns(_term(axis, law_of(np.eye(len(first) * len(second)))))[rows] * weight
    columns = columns - known @ (known.T @ columns)
    tried = (*COUNTS, *MORE_OF_TWO) if across else COUNTS
    shapes, _ = smooth_parts(columns, current.residual[rows] * weight[:, 0], 0.0, tried[-1], len(second))
    counts = [n for n in tried if n <= shapes.shape[1]]
    laws = [law_of(shapes[:, :n]) for n in counts]
    trials = [fit_terms(design, [*current.terms, _term(axis, law)]) for law in laws]
    return min(trials, key=lambda f: held_out_cost(design, f, design.train), default=None)


def _term(axis: int, law: EmpiricalLaw) -> Regressor:
    return Regressor(NAMELESS, axis, law.coefficients, law=law)


def _is_accepted(design: Design, before: Fit, after: Fit, axis: int, tried: int) -> bool:
    """Whether a law is significant, seen and unseen, and brings its axis to the noise or takes nearly all."""
    if training_p(before, after) > SIGNIFICANT / tried or held_out_p(design, before, after) > FALSE_ALARM:
        return False
    law, at = after.terms[-1], len(after.terms[-1].names)
    felt = design.columns(law)[design.train & (design.axis == axis)]
    if not is_known(felt, after.value[-at:], after.covariance[-at:, -at:]):
        return False
    rows = judged_rows(design) & (design.axis == axis)
    noise = float(np.mean(noise_of(design, after)[rows]))
    old, new = (float(np.mean(f.held_out[rows] ** 2)) - noise for f in (before, after))
    return bool(axes_at_noise(design, after)[axis]) or new < (1.0 - NEARLY_ALL) * old
