"""What no cause explains on an axis of one rigid mass: a smooth law over its velocity, position or both."""

from __future__ import annotations

import numpy as np

from invid.effects.laws.empirical_law import EmpiricalLaw, is_known, is_like_law, knots_of, most_knots
from invid.effects.motion_effect import OF_RATE
from invid.effects.registry import BY_CAUSE
from invid.effects.supposed.of_effect import SmoothLaw
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.price import NUMBER, pays, price
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.numerics.smooth_parts import smooth_parts
from invid.rigid_motion.fit import Fit, axes_at_noise, falls, fit_terms, missing_powers, settled
from invid.rigid_motion.rows import Rows
from invid.rigid_motion.terms import Base, Term
from invid.wording.sentence import sentence

MOST, MOST_OF_TWO = 20, 80
"""Most shapes of a law over one quantity and over two (empirical, for the time)."""
ROUNDS = 4
"""Times that its shapes are chosen anew beside what it leaves (numerical)."""
NEARLY_ALL = 0.98
"""Share of what is missing on its axis in rows kept out that a law must take where it does not reach the
noise (empirical)."""
PART = 0.1
"""Share of what was missing, and of what is left, that counts as something (contract: nine tenths)."""
BINS, LEAST_BINNED = 10, 20.0
"""Bins of a quantity over which a mean is taken, and independent rows that it takes (statistical)."""


def add_laws(rows: Rows, current: Fit) -> Fit:
    """The fit with a law on every axis where causes leave something and one law takes nearly all of it."""
    for axis in np.flatnonzero(~axes_at_noise(rows, current)):
        for quantities in ([("velocity", ""), ("position", "")], [("velocity", "position")]):
            if budget.is_left_out(sentence("a law without a name")):
                return current
            fits = [f for q in quantities for f in law_fits(rows, current, int(axis), q)]
            good = [f for f in fits if _is_accepted(rows, current, f, int(axis))]
            if good:
                current = min(good, key=lambda f: f.fitted + NUMBER * f.numbers)
                break
    return current


def law_fits(rows: Rows, current: Fit, axis: int, quantities: tuple[str, str]) -> list[Fit]:
    """The fits with a law over one quantity or two instead of what may stand for a part of it, alone and with
    dry friction beside it, which jumps."""
    over = quantities[0]
    kept = [
        t
        for t in current.terms
        if t.axis != axis or isinstance(t.law, Base) or not is_like_law(BY_CAUSE[t.cause], over)
    ]
    offset, moves = Term(Base.TIME_OFFSET, axis), any(t.label == (Base.INERTIA, axis, None) for t in kept)
    if moves and not any(t.law in (Base.TIME_OFFSET, Base.DELAY) and t.axis == axis for t in kept):
        kept.append(offset)  # without the law it may have been lost
    jumps = over in OF_RATE and any(t.axis == axis and t.law is Part.DRY for t in current.terms)
    options = [kept, [*kept, Term(Part.DRY, axis)]] if jumps else [kept]
    fits = (_with_law(rows, settled(rows, terms), axis, quantities) for terms in options)
    return [f for f in fits if f is not None]


def _with_law(rows: Rows, bare: Fit, axis: int, quantities: tuple[str, str]) -> Fit | None:
    """The fit with the shapes of a law that pay; ``None`` where none does or a quantity does not move."""
    knots = [_knots(rows, axis, q, two=bool(quantities[1])) for q in quantities if q]
    if any(k is None for k in knots):
        return None
    (over, across), (first, *rest) = quantities, [k for k in knots if k is not None]
    second = rest[0] if rest else [0.0]

    def term_of(shapes: Float64) -> Term:
        return Term(SmoothLaw(EmpiricalLaw(over, first, shapes, across, second)), axis)

    every, matrix, left = (
        rows.colour.whitened(rows, x)
        for x in (
            rows.columns(term_of(np.eye(len(first) * len(second)))),
            rows.matrix(bare.terms),
            bare.residual[:, None],
        )
    )
    price, best = float(np.log(max(rows.independent.sum(), 2.0))), bare
    for _ in range(ROUNDS):
        scale = best.strength[rows.axis, None]
        felt, known, missed = ((x / scale)[rows.train] for x in (every, matrix, left))
        known = np.linalg.qr(known / np.maximum(np.linalg.norm(known, axis=0), 1e-300))[0]
        felt = felt - known @ (known.T @ felt)
        shapes, _ = smooth_parts(felt, missed[:, 0], price, MOST_OF_TWO if across else MOST, len(second))
        if not shapes.shape[1]:
            break
        more = fit_terms(rows, [*bare.terms, term_of(shapes)])
        if best is not bare and more.kept > best.kept:
            break
        best = more
    return None if best is bare else best


def _knots(rows: Rows, axis: int, over: str, *, two: bool) -> list[float] | None:
    """Knots over a quantity in the rows fitted; ``None`` where it does not move."""
    moved = [m.rows(m.velocity if over in OF_RATE else m.position) for m in rows.motions]
    seen = rows.on_axis(moved, axis)[rows.train[rows.axis == axis]]
    return knots_of([seen], most_knots(over, two=two))


def any_law(rows: Rows, axis: int, over: str) -> list[Term]:
    """The term of any smooth law over a quantity, where that moves."""
    knots = _knots(rows, axis, over, two=False)
    return [] if knots is None else [Term(SmoothLaw(EmpiricalLaw(over, knots, np.eye(len(knots)))), axis)]


def _is_accepted(rows: Rows, before: Fit, after: Fit, axis: int) -> bool:
    """Whether a law pays, is known, and brings its axis to the noise or takes nearly all."""
    if not pays(*falls(before, after), price(max(after.numbers - before.numbers, 1))):
        return False
    law = after.terms[-1]
    part = after.span(law)
    felt = rows.columns(law)[rows.train & (rows.axis == axis)]
    if not is_known(felt, after.value[part], after.covariance[part, part]):
        return False
    old, new = missing_powers(rows, before)[axis], missing_powers(rows, after)[axis]
    return bool(axes_at_noise(rows, after)[axis] or new < (1.0 - NEARLY_ALL) * old)


def without_wrong_laws(rows: Rows, final: Fit) -> Fit:
    """The fit without friction on an axis where it leaves a tenth that still depends on the velocity.

    Friction there is, by a law that none of them is: of a drag with the square of the speed viscous friction
    takes most, at a size that means nothing.
    """
    bare = fit_terms(rows, [t for t in final.terms if t.is_base])
    before, after = missing_powers(rows, bare), missing_powers(rows, final)
    wrong = {
        i
        for i in range(rows.axes)
        if after[i] > PART * before[i] and depends_on(rows, final, i, [m.velocity for m in rows.motions])
    }
    kept = [
        t for t in final.terms if t.axis not in wrong or t.is_base or BY_CAUSE[t.cause].family != "friction"
    ]
    return final if len(kept) == len(final.terms) else settled(rows, kept)


def depends_on(rows: Rows, result: Fit, axis: int, quantity: list[Float64]) -> bool:
    """Whether more than a tenth of what an axis misses, and significantly so, is in its mean over ten bins of
    a quantity (n, M) of each motion."""
    driver = rows.on_axis([m.rows(q) for m, q in zip(rows.motions, quantity, strict=True)], axis)
    left = result.held_out[rows.axis == axis]
    bins = np.searchsorted(np.quantile(driver, np.linspace(0, 1, BINS + 1)[1:-1]), driver)
    sums, counts = np.bincount(bins, left, BINS), np.maximum(np.bincount(bins, minlength=BINS), 1)
    share = float(np.sum(sums**2 / counts) / max(np.sum(left**2), 1e-300))
    return bool(share > max(PART, LEAST_BINNED * rows.axes / rows.independent.sum()))
