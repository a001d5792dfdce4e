"""The search for causes of one rigid machine: laws beside motors' friction, each at the price of the shared
search, then out again what does not pay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.price import NUMBER, PARTS, pays, price_at_motors
from invid.numerics import budget
from invid.rigid_motion.fit import (
    Fit,
    axes_at_noise,
    axis_powers,
    chance_of_gain,
    falls,
    fit_terms,
    load_terms,
    missing_torque,
    settled,
)
from invid.rigid_motion.rows import Rows
from invid.rigid_motion.terms import (
    ANY_BEND,
    BEND,
    BY_DIRECTION,
    COGGING,
    GRAVITY,
    HELD,
    PRESLIDING,
    RISE,
    Base,
    Term,
    fits_beside,
)
from invid.wording.sentence import sentence

FITTED = 5
"""Laws of the scores that are fitted (empirical, for the time)."""
NEIGHBOUR, ABOVE = 0.5, 0.1
"""Logarithms by which a shape may lie below and above the best of its grid (numerical)."""
ALIKE = 1e-4
"""Share of a law's power that nothing else explains, below which it is none of its own, as for chains."""
LEAST_GAIN = 0.1
"""Least share of the power that rows kept out miss on an axis that a cause takes. Empirical: on measured axes
the rigid model itself is wrong by some per cent of it in ways that any smooth law absorbs."""
MOST_CHANCE = 0.1
"""Chance up to which a gain counts as one (statistical: each cause has paid a price before)."""
CHOSEN = (Base.CONFIGURATION, Base.CARRIED)
"""Parts of the base that stay only where they pay."""
FRICTION = (Part.DRY, Part.VISCOUS, Part.OFFSET)
BY_WAY: tuple[object, ...] = (BEND, BY_DIRECTION)
"""Laws that make of a motor's friction one that differs by direction."""


@dataclass(frozen=True, eq=False)
class Cause:
    """A cause with the terms that are it, its own law first."""

    name: str
    terms: tuple[Term, ...]


def causes_of(terms: Sequence[Term], *parts_of_base: Base) -> list[Cause]:
    """The causes that terms are: dry friction with its rise is one, and all friction by direction; with them
    some parts of the base."""
    out = []
    for axis in sorted({t.axis for t in terms}):
        here = [t for t in terms if t.axis == axis and (not t.is_base or t.law in parts_of_base)]
        heads = [t for t in here if t.law in BY_WAY] or [t for t in here if t.law is RISE]
        if heads:
            parts = FRICTION if heads[0].law in BY_WAY else (Part.DRY,)
            whole = (*heads, *(t for t in here if t.law in parts))
            out.append(Cause(heads[0].cause, whole))
            here = [t for t in here if t not in whole]
        slid = [t for t in here if t.law is PRESLIDING]
        if slid:
            whole = (*slid, *(t for t in here if t.law is HELD))
            out.append(Cause(PRESLIDING.cause, whole))
            here = [t for t in here if t not in whole]
        out += [Cause(t.cause, (t,)) for t in here]
    return out


def search(rows: Rows, base: list[Term], candidates: Sequence[Term]) -> tuple[Fit, bool]:
    """The fit with every cause that pays its price, and whether the budget ended the search."""
    current, seen = settled(rows, base), set()
    while True:
        current, cut = _with_further(rows, current, candidates)
        current = without_idle(rows, current, candidates)
        labels = frozenset(t.label for t in current.terms)
        if cut or labels in seen:
            return current, cut or budget.is_left_out(budget.FURTHER_CAUSES)
        seen.add(labels)


def _with_further(rows: Rows, current: Fit, candidates: Sequence[Term]) -> tuple[Fit, bool]:
    """The fit with laws that pay beside it, and whether the budget ended the search."""
    for number in range(100):
        budget.tell("weighing", 1.0 - 0.7**number)
        if budget.is_left_out(sentence("causes beside {number} found", number=number)):
            return current, True
        best = best_law(rows, current, [*candidates, *load_terms(rows, current)])
        if best is None:
            break
        current = best
    return current, False


def best_law(rows: Rows, current: Fit, candidates: Sequence[Term]) -> Fit | None:
    """The fit with the law that brings most beside its price; ``None`` where none pays it."""
    quiet = axes_at_noise(rows, current)
    labels, here = {t.label for t in current.terms}, {(t.law, t.axis) for t in current.terms}
    open_ones = [
        t
        for t in candidates
        if t.label not in labels
        and not quiet[t.axes].all()
        and (t.law not in (RISE, *BY_WAY) or (Part.DRY, t.axis) in here)
    ]
    trials = []
    best = leaders(rows, current, open_ones)
    # It comes with a constant, beside which alone it may be much.
    best += [t for t in open_ones if t.law is BY_DIRECTION and t not in best]
    for term in best:
        trial = with_term(rows, current, term, candidates)
        if trial.free[trial.span(trial.terms[-1])].any() and _pays(
            rows, trial.terms[-1], candidates, (current, trial)
        ):
            trials.append((sum(falls(current, trial)) - NUMBER * (trial.numbers - current.numbers), trial))
    return max(trials, key=lambda t: t[0])[1] if trials else None


def leaders(rows: Rows, current: Fit, candidates: Sequence[Term]) -> list[Term]:
    """The best shape of each of the best laws by their fall to first order."""
    best: dict[object, tuple[float, Term]] = {}
    for fall, term in zip(score(rows, current, candidates), candidates, strict=True):
        worth = fall - 0.5 * NUMBER * term.numbers
        if worth > best.get(term.label, (0.0, term))[0]:
            best[term.label] = worth, term
    return [t for _, t in sorted(best.values(), key=lambda b: -b[0])[:FITTED]]


def score(rows: Rows, current: Fit, candidates: Sequence[Term]) -> list[float]:
    """Falls of −2 ln L on the rows fitted to first order, everything else moving with each law."""
    train, scale = rows.train, current.strength[rows.axis, None]
    a = (rows.colour.whitened(rows, rows.matrix(current.terms)) / scale)[train][:, current.free]
    known = np.linalg.qr(a / np.maximum(np.linalg.norm(a, axis=0), 1e-300))[0]
    left, out = (rows.colour.whitened(rows, current.residual) / scale[:, 0])[train], []
    for term in candidates:
        columns = (rows.colour.whitened(rows, rows.columns(term)) / scale)[train]
        own = columns - known @ (known.T @ columns)
        if not np.sum(own**2) > ALIKE * np.sum(columns**2):
            out.append(0.0)
            continue
        x, low = np.linalg.lstsq(own, left, rcond=1e-10)[0], np.array(term.low)
        out.append(float(x @ own.T @ left) if (x >= low).any() else 0.0)
    return out


def with_term(rows: Rows, current: Fit, term: Term, grid: Sequence[Term] = ()) -> Fit:
    """The fit with a further law, without what it takes the place of, the shapes of all at their best."""
    terms = [t for t in current.terms if fits_beside(term, t)]
    if term.law is BY_DIRECTION:  # half of what dry friction has more forward is its constant
        offset = Term(Part.OFFSET, term.axis)
        terms = [*(t for t in terms if fits_beside(offset, t)), offset]
    terms.append(term)
    for shaped in [t for t in terms if t.shape]:
        terms = reshaped(rows, terms, shaped, [t for t in grid if t.label == shaped.label])
    return settled(rows, terms)


def reshaped(rows: Rows, terms: list[Term], term: Term, grid: Sequence[Term]) -> list[Term]:
    """The terms with the shape of one at the best point of its grid, then between these."""
    at = next(k for k, t in enumerate(terms) if t is term)

    def moved(to: Term) -> list[Term]:
        return [*terms[:at], to, *terms[at + 1 :]]

    def left(to: Term) -> float:
        return fit_terms(rows, moved(to)).fitted

    def with_shape(first: float) -> Term:
        return replace(best, shape=(float(first), *best.shape[1:]))

    is_ripple = term.law is COGGING
    best = min([term, *(() if is_ripple else grid)], key=left)
    first, reach = best.shape[0], 0.35 / float(np.exp(best.shape[0])) if is_ripple else NEIGHBOUR
    low, high = first - reach, first + (reach if is_ripple else ABOVE)
    result = scipy.optimize.minimize_scalar(
        lambda x: left(with_shape(x)), bounds=(low, high), method="bounded", options={"xatol": 1e-2 * reach}
    )
    return moved(with_shape(result.x) if result.fun < left(best) else best)


def without_idle(rows: Rows, current: Fit, candidates: Sequence[Term]) -> Fit:
    """The fit without what does not pay beside all others, the cheapest first."""
    while not budget.is_left_out(sentence("causes that others make superfluous")):
        bound = [t for t in current.terms if not t.is_base and not current.free[current.span(t)].any()]
        if bound:
            gone = {id(t) for t in bound}
            current = settled(rows, [t for t in current.terms if id(t) not in gone])
            continue
        idle = []
        for term in [t for t in current.terms if not t.is_base or t.law in CHOSEN]:
            simpler = settled(rows, _less(current.terms, term))
            if not _pays(rows, term, candidates, (simpler, current)):
                idle.append((sum(falls(simpler, current)), simpler))
        if not idle:
            break
        current = min(idle, key=lambda i: i[0])[1]
    return current


def _less(terms: list[Term], gone: Term) -> list[Term]:
    """The terms without one, or with what is simpler in its place; without what stands on it alone."""
    rest = [t for t in terms if t is not gone]
    if gone.law is GRAVITY:
        return [*rest, Term(Part.OFFSET, gone.axis)]
    if gone.law is BEND:
        return [*rest, replace(gone, law=RISE)]
    if gone.law is Part.DRY:
        rest = [t for t in rest if t.axis != gone.axis or t.law not in (RISE, *BY_WAY)]
    return rest


def _pays(rows: Rows, term: Term, candidates: Sequence[Term], fits: tuple[Fit, Fit]) -> bool:
    """Whether a term pays for its numbers and for the shapes that were looked at, in the fit after over that
    before."""
    before, after = fits
    looked = max(sum(t.label == term.label for t in candidates), 1)
    befores, mine = [before], term.axes
    if term.law is BEND and not any(t.law is BY_DIRECTION and t.axis == term.axis for t in before.terms):
        # What bends towards less friction alike both ways has no name; it is no asymmetry either.
        rest = [t for t in before.terms if t.axis != term.axis or t.law is not RISE]
        befores.append(fit_terms(rows, [*rest, replace(term, law=ANY_BEND)]))
    new = axis_powers(rows, rows.judged, after.held_out)[mine]
    return all(
        bool((new < (1.0 - LEAST_GAIN) * axis_powers(rows, rows.judged, less.held_out)[mine]).any())
        and pays(*falls(less, after), price_at_motors(PARTS * looked, max(after.numbers - less.numbers, 1)))
        for less in befores
    )


def without_harm(rows: Rows, current: Fit) -> Fit:
    """The fit without causes that do not lower what every row kept out misses beyond the chance of it, the
    least first."""
    while not rows.steady and (causes := causes_of(current.terms, *CHOSEN)):
        after, trials = missing_torque(rows, current), []
        for cause in causes:
            fewer = without(rows, current, cause)
            left = missing_torque(rows, fewer), after
            trials += [(chance_of_gain(rows, left, cause.terms[0].axis), fewer)]
        chance, fewer = max(trials, key=lambda t: t[0])
        if chance < MOST_CHANCE or budget.is_left_out(sentence("causes that help no row kept out")):
            break
        current = fewer
    return current


def without(rows: Rows, current: Fit, cause: Cause) -> Fit:
    """The fit without a cause."""
    gone = {id(t) for t in cause.terms}
    return settled(rows, [t for t in current.terms if id(t) not in gone])
