"""Selection of causes: forward by significance, then backward elimination.

A cause is taken when the training rows say so at one per mille, and rows kept out at one per cent: their own
pieces in turn, or the validation rows; the tests count independent rows (serial correlation) and pieces, not
samples. What was taken is then asked for once more, beside all others, on the validation rows. While the
strongest causes are still missing, a fit of the rest bends to the moves it was made on, and other moves tell
nothing about a cause that is added to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy

from invid.numerics import budget
from invid.numerics.arrays import Bool, Float64
from invid.rigid_motion.load_friction import fix_loads, load_terms
from invid.rigid_motion.regression import Design, Fit, fit_terms, noise_of
from invid.rigid_motion.regressors import ASYMMETRIC, Regressor

Label = tuple[str, int, int | None, str]

SIGNIFICANT = 1e-3
"""Chance, over all candidates of a step together, that noise passes the training gain; as for chains."""
FALSE_ALARM = 0.01
"""False alarms allowed for every other decision."""
LEAST_GAIN = 0.1
"""Smallest share of the held-out residual power that a cause must explain. Empirical: on measured axes the
rigid model itself is wrong by some per cent of the remaining power in ways that any smooth term absorbs.
Machines drawn at random (six decades of inertia, 200 to 2000 Hz, tests/property) confirm it."""


TELLING = 8
"""Pieces from which on they are counted: a sign test of fewer cannot reach ``FALSE_ALARM``, whatever the
gain."""


@dataclass
class Selection:
    """The result of a selection."""

    final: Fit
    is_cut_short: bool = False
    """Whether the budget ended the search."""


def root_mean_square(values: Float64) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def judged_rows(design: Design) -> Bool:
    """Rows a result is judged on: validation rows, or all of them (each predicted unseen)."""
    return design.validate if design.has_validation else design.train


def _piece_costs(design: Design, residual: Float64, rows: Bool) -> Float64:
    weighted = (residual * design.weight)[rows] ** 2
    index = np.unique(design.group[rows], return_inverse=True)[1]
    sums: Float64 = np.bincount(index, weighted).astype(np.float64)
    return sums


def held_out_p(design: Design, before: Fit, after: Fit, rows: Bool | None = None) -> float:
    """One-sided p-value that ``after`` predicts unseen pieces no better than ``before``.

    ``rows``: those that are asked, ``judged_rows`` by default.
    """
    asked = judged_rows(design) if rows is None else rows
    old, new = (_piece_costs(design, f.held_out, asked) for f in (before, after))
    difference = old - new
    count = difference.size
    chances = [_gain_p(design, old, new, after, int(asked.sum()))]
    spread = float(difference.std(ddof=1)) if count > 1 else 0.0
    if count >= TELLING and spread > 0:
        t = float(difference.mean() / (spread / np.sqrt(count)))
        chances.append(float(scipy.stats.t.sf(t, count - 1)))
        # Gains are skewed over pieces (a few hold all the reversals): a sign test sees what the t misses.
        win_count = int((difference > 0).sum())
        chances.append(float(scipy.stats.binomtest(win_count, count, 0.5, alternative="greater").pvalue))
    return min(1.0, len(chances) * min(chances))


def _gain_p(design: Design, old: Float64, new: Float64, after: Fit, asked: int) -> float:
    """The same from the gain in all, in the scatter of independent rows, seen and unseen: one coefficient's.

    Few pieces cannot be counted, and of many only a few may hold the motion that shows a cause. The piece
    that gains most is left out: what stands on it alone is an event, not a cause.
    """
    gain = float((old - new).sum()) - (float(np.max(old - new)) if old.size >= 3 else 0.0)
    if gain <= 0:
        return 1.0
    seen = int(design.train.sum())
    length = seen / max(after.effective, 1.0)
    scatter = (after.cost * seen + float(new.sum())) / (seen + asked)
    free = max((seen + asked) / length - after.value.size, 1.0)
    return float(scipy.stats.f.sf(gain / length / max(scatter, 1e-300), 1, free))


def training_p(before: Fit, after: Fit) -> float:
    """F test on the training rows, with as many rows as are independent."""
    added = max(after.value.size - before.value.size, 1) + (1 if any(t.shape for t in after.terms) else 0)
    free = after.effective - after.value.size - 1
    if free <= 1 or after.cost <= 0:
        return 0.0 if after.cost < before.cost else 1.0
    ratio = max(before.cost / after.cost - 1.0, 0.0) * free / added
    return float(scipy.stats.f.sf(ratio, added, free))


def held_out_cost(design: Design, result: Fit, rows: Bool | None = None) -> float:
    """Weighted mean square of what unseen rows miss, of ``judged_rows`` by default."""
    asked = judged_rows(design) if rows is None else rows
    return float(np.mean((result.held_out * design.weight)[asked] ** 2))


def _predicts(design: Design, before: Fit, after: Fit, rows: Bool, least: float) -> bool:
    """Whether ``after`` predicts rows it has not seen better, surely and by enough to matter."""
    return held_out_p(design, before, after, rows) < FALSE_ALARM and held_out_cost(design, after, rows) < (
        1 - least
    ) * held_out_cost(design, before, rows)


def _axes_of(term: Regressor) -> list[int]:
    """The axes whose torque a term is part of."""
    return [term.axis] if term.other is None else [term.axis, term.other]


def axes_at_noise(design: Design, result: Fit) -> Bool:
    """(M,) axes whose unseen rows hold no more than noise, at one per cent: nothing is asked for there."""
    floor, rows = noise_of(design, result), judged_rows(design)
    length = int(design.train.sum()) / max(result.effective, 1.0)
    out = np.zeros(design.axes, dtype=np.bool_)
    for i in range(design.axes):
        mine = rows & (design.axis == i)
        count = float(mine.sum()) / length
        if count > 0:
            most = float(scipy.stats.chi2.isf(FALSE_ALARM, count)) / count
            out[i] = float(np.mean(result.held_out[mine] ** 2)) <= most * float(np.mean(floor[mine]))
    return out


def is_needed(design: Design, without: Fit, current: Fit) -> bool:
    """True where ``current`` is better than ``without`` on both counts and by enough to matter."""
    return (
        training_p(without, current) < FALSE_ALARM
        and held_out_p(design, without, current) < 5 * FALSE_ALARM
        and held_out_cost(design, current) < (1 - LEAST_GAIN) * held_out_cost(design, without)
    )


def is_physical(result: Fit, term: Regressor) -> bool:
    """Whether no coefficient that must be positive is negative."""
    value, _ = result.of(term)
    return all(value[term.names.index(n)] >= 0 for n in term.positive if n not in term.held)


def hold_at_bounds(design: Design, terms: list[Regressor], term: Regressor) -> Regressor | None:
    """The last of ``terms`` with coefficients at zero that would be below it; ``None`` where that forbids it.

    Friction that pushes is none. With one coefficient left a law is a simpler cause, and is tried as such.
    """
    rest = [t for t in terms if t is not term]
    while True:
        trial = fit_fast(design, [*rest, term], 1.0)
        value = trial.value[trial.value.size - len(term.names) :]
        size = value * np.sqrt(np.mean(design.columns(term) ** 2, axis=0))
        free = [(k, n) for k, n in enumerate(term.names) if n in term.positive and n not in term.held]
        below = [(size[k], n) for k, n in free if value[k] < 0]
        if not below:
            return term
        if len(term.names) - len(term.held) <= 2:
            return None
        term = replace(term, held=(*term.held, min(below)[1]))


def join_term(terms: list[Regressor], new: Regressor) -> list[Regressor]:
    """The terms with ``new`` in place of those that it contains."""
    kept = [
        t
        for t in terms
        if not (t.axis == new.axis and t.other is None and t.cause in new.replaces)
        and t.label != new.label
        and not _falls_otherwise(t, new)
    ]
    return [*kept, new]


def _falls_otherwise(term: Regressor, new: Regressor) -> bool:
    """Whether both are the weight on one joint, of its own link or of all that hangs on it: one takes the
    other's place."""
    return term.cause == new.cause == "gravity" and term.axis == new.axis and term.other != new.other


def best_of_label(
    design: Design, terms: list[Regressor], options: list[Regressor], length: float = 1.0
) -> Fit | None:
    """The best shape of one cause beside ``terms``; ``None`` where physics forbids all of them."""
    best: Fit | None = None
    for term in options:
        trial = fit_fast(design, join_term(terms, term), length)
        if not is_physical(trial, term):
            bounded = hold_at_bounds(design, trial.terms, term)
            if bounded is None:
                continue
            trial = fit_fast(design, join_term(terms, bounded), length)
        if best is None or trial.cost < best.cost:
            best = trial
    return None if best is None else fit_terms(design, best.terms)


def fit_fast(design: Design, terms: list[Regressor], length: float) -> Fit:
    """A fit without kept-out pieces, for the search over shapes."""
    matrix, weight = design.matrix(terms), design.weight
    train = design.train
    wm, wt = matrix[train] * weight[train, None], design.torque[train] * weight[train]
    scale = np.sqrt((wm**2).sum(axis=0))
    scale[scale == 0] = 1.0
    value = np.linalg.lstsq(wm / scale, wt, rcond=1e-10)[0] / scale
    cost = float(np.mean((wt - wm @ value) ** 2))
    none = np.zeros(0)
    return Fit(
        terms, value, np.full((value.size, value.size), np.nan), none, none, cost, train.sum() / length, 1.0
    )


def select_terms(
    design: Design, base: list[Regressor], candidates: list[Regressor], *, most: int = 12
) -> Selection:
    """Forward selection, then elimination of what is not significant, until both leave the same causes.

    One may go beside others that go later, or not stand out beside them.
    """
    labels: dict[Label, list[Regressor]] = {}
    for c in candidates:
        labels.setdefault(c.label, []).append(c)
    terms, seen = list(base), set[frozenset[Label]]()
    while True:
        terms, cut = _add_terms(design, terms, labels, most)
        found = frozenset(t.label for t in terms)
        current, terms = prune_terms(design, terms)
        kept = frozenset(t.label for t in terms)
        if cut or kept == found or kept in seen:
            return Selection(current, cut or budget.is_left_out("further causes"))
        seen.add(kept)


def _add_terms(
    design: Design, terms: list[Regressor], labels: Mapping[Label, list[Regressor]], most: int
) -> tuple[list[Regressor], bool]:
    """The terms with those that are significant beside them, and whether the budget ended the search."""
    current = fit_terms(design, terms)
    unseen = [design.train, design.validate] if design.has_validation else [design.train]
    cut = False
    for number in range(most):
        length = int(design.train.sum()) / max(current.effective, 1.0)
        tried_labels: list[tuple[Regressor, Fit]] = []
        quiet = axes_at_noise(design, current)
        for label, options in labels.items():
            if quiet[_axes_of(options[0])].all():
                continue
            if budget.is_spent():
                break
            budget.tell("weighing", 1.0 - 0.7**number, cause=options[0].cause)
            if any(t.label == label for t in terms) or not can_join(terms, options[0]):
                continue
            trial = best_of_label(design, terms, options, length)
            if trial is not None:
                tried_labels.append((trial.terms[-1], trial))
        cut = cut or budget.is_left_out(f"causes beside {number} found")
        if cut:  # of a step cut short nobody knows what would have been best
            break
        tried_labels += _load_candidates(design, current, terms, length)
        accepted = [
            (t, f)
            for t, f in tried_labels
            if training_p(current, f) < SIGNIFICANT / max(len(tried_labels), 1)
            and any(_predicts(design, current, f, rows, LEAST_GAIN) for rows in unseen)
        ]
        if not accepted:
            # Two strong causes hide each other: what the other leaves is no noise, and neither stands out.
            pair = _best_pair(design, current, [t for t, _ in tried_labels], terms)
            if pair is None:
                break
            accepted, tried_labels = [pair], [pair]
        # Information criterion on independent rows: more coefficients must earn their place.
        rows = current.effective
        _, best = min(accepted, key=lambda p: information_criterion(p[1], rows))
        terms = fix_loads(design, list(best.terms))
        current = fit_terms(design, terms)
        design.reweigh(current.residual)
        current = fit_terms(design, terms)
    return terms, cut


def _load_candidates(
    design: Design, current: Fit, terms: list[Regressor], length: float
) -> list[tuple[Regressor, Fit]]:
    """Candidates of load-dependent friction with the load of the present fit, on every axis without one."""
    labels: dict[Label, list[Regressor]] = {}
    for term in load_terms(current, design):
        if not any(t.label == term.label for t in terms):
            labels.setdefault(term.label, []).append(term)
    trials = [best_of_label(design, terms, options, length) for options in labels.values()]
    return [(t.terms[-1], t) for t in trials if t is not None]


def _best_pair(
    design: Design, current: Fit, found: list[Regressor], terms: list[Regressor]
) -> tuple[Regressor, Fit] | None:
    """The best two causes that only together are significant; the tests count the pairs tried."""
    trials: list[tuple[Regressor, Fit]] = []
    for one, other in combinations(found, 2):
        if budget.is_left_out("pairs of causes"):
            break
        if one.label == other.label or _falls_otherwise(one, other) or not can_join([*terms, one], other):
            continue
        if one.cause in other.replaces or other.cause in one.replaces:
            continue
        trial = fit_terms(design, join_term(join_term(terms, one), other))
        if is_physical(trial, one) and is_physical(trial, other):
            trials.append((other, trial))
    good = [
        (t, f)
        for t, f in trials
        if training_p(current, f) < SIGNIFICANT / len(trials)
        and _predicts(design, current, f, design.train, 1 - (1 - LEAST_GAIN) ** 2)
    ]
    return min(good, key=lambda p: information_criterion(p[1], current.effective)) if good else None


def can_join(terms: list[Regressor], new: Regressor) -> bool:
    """True where ``new`` has what it builds on and is no part of what is there already."""
    here = {t.cause for t in terms if t.axis == new.axis}
    if (new.needs and not here & set(new.needs)) or here & set(new.excludes):
        return False
    # Over less than a turn, a constant is the cosine of a gravity angle: they are one cause.
    one = ("torque_offset", "asymmetric_friction")
    if new.cause in one and any(t.cause == "gravity" and t.axis == new.axis for t in terms):
        return False
    # A part of what is already there adds nothing.
    return not any(new.cause in t.replaces and t.axis == new.axis and t.other is None for t in terms)


def information_criterion(result: Fit, rows: float) -> float:
    """Schwarz' criterion in ``rows`` independent rows, the same number for all that are compared."""
    shapes = sum(t.shape is not None for t in result.terms)
    count = max(rows, 2.0)
    return count * float(np.log(max(result.cost, 1e-300))) + (result.value.size + shapes) * float(
        np.log(count)
    )


def _simpler_terms(term: Regressor) -> list[list[Regressor]]:
    """Simpler replacements of a compound term, fewest coefficients first."""
    i = term.axis
    viscous = Regressor("viscous_friction", i, ("coefficient",), ("coefficient",))
    coulomb = Regressor("coulomb_friction", i, ("torque",), ("torque",))
    offset = Regressor("torque_offset", i, ("torque",))
    dry = ("coulomb_friction", "viscous_friction", "torque_offset", "stribeck_friction")
    plain = Regressor(
        "asymmetric_friction", i, ASYMMETRIC, ASYMMETRIC, replaces=dry, needs=("coulomb_friction",)
    )
    if term.cause == "asymmetric_friction":
        options = [[coulomb], [coulomb, viscous], [coulomb, offset], [coulomb, viscous, offset]]
        if len(term.names) == 6:
            bend = Regressor(
                "stribeck_friction", i, ("coulomb", "excess"), ("coulomb", "excess"), shape=term.shape,
                exponent=term.exponent, replaces=("coulomb_friction",), needs=("coulomb_friction",),
            )  # fmt: skip
            options += [[plain], [bend, viscous], [bend, viscous, offset]]
        return options
    if term.cause == "stribeck_friction":
        return [[coulomb]]
    return [[]]


def _symmetric_if_equal(design: Design, current: Fit, rest: list[Regressor], term: Regressor) -> Fit | None:
    """Dry and viscous friction instead of asymmetric friction, where the difference is not significant.

    What bends at low speed alike in both directions, towards less friction, has no name in the catalogue (a
    coarse encoder at reversals, friction that grows with the root of speed): it is no asymmetry either.
    """
    if term.cause != "asymmetric_friction" or term.shape is None:
        return None
    i = term.axis
    bend = Regressor("stribeck_friction", i, ("coulomb", "excess"), shape=term.shape, exponent=term.exponent)
    viscous = Regressor("viscous_friction", i, ("coefficient",), ("coefficient",))
    coulomb = Regressor("coulomb_friction", i, ("torque",), ("torque",))
    offset = Regressor("torque_offset", i, ("torque",))
    for more in ([], [offset]):
        if more and any(t.cause == "gravity" and t.axis == i for t in rest):
            continue
        bent = fit_terms(design, [*rest, bend, viscous, *more])
        # A bend towards more friction is Stribeck friction, and is tried as such.
        if bent.of(bend)[0][1] >= 0 or is_needed(design, bent, current):
            continue
        simple = fit_terms(design, [*rest, coulomb, viscous, *more])
        if is_physical(simple, coulomb) and is_physical(simple, viscous):
            return simple
    return None


def fit_consistent_loads(design: Design, terms: list[Regressor]) -> tuple[Fit, list[Regressor]]:
    """The fit with every load computed from the rest, and without terms of a wrong sign.

    Beside later causes a term may get an impossible sign; the latest of them is dropped first, and an inertia
    that the motion does not show last, with its couplings.
    """
    while True:
        terms = fix_loads(design, terms)
        current = fit_terms(design, terms)
        wrong = [t for t in terms if not is_physical(current, t)]
        if not wrong:
            return current, terms
        last = next((t for t in reversed(wrong) if not t.base), wrong[-1])
        bounded = hold_at_bounds(design, terms, last)
        if bounded is not None:
            terms = [bounded if t is last else t for t in terms]
            continue
        terms = [t for t in terms if t is not last and not _is_coupled_to(t, last)]
        if last.cause == "stribeck_friction":
            terms += _simpler_terms(last)[0]


def _is_coupled_to(term: Regressor, inertia: Regressor) -> bool:
    """Whether a term couples the motion of an axis to one whose inertia is ``inertia``."""
    coupled = term.cause in ("coupling", "configuration") and inertia.cause == "inertia"
    return coupled and inertia.axis in (term.axis, term.other)


def prune_terms(design: Design, terms: list[Regressor]) -> tuple[Fit, list[Regressor]]:
    """The terms without those that are not significant, or with simpler ones in their place."""
    changed = True
    while changed:
        changed = False
        if budget.is_left_out("causes that others make superfluous"):
            return fit_terms(design, terms), terms
        current, terms = fit_consistent_loads(design, terms)
        for term in [t for t in terms if not t.base or t.cause == "configuration"]:
            rest = [t for t in terms if t is not term]
            symmetric = _symmetric_if_equal(design, current, rest, term)
            if symmetric is not None:
                current, terms, changed = symmetric, list(symmetric.terms), True
                break
            p_value_of = any(t.cause == "gravity" and t.axis == term.axis for t in rest)
            for replacement in _simpler_terms(term):
                # A falling load holds the joint with a constant of its own: an offset beside it is no cause.
                if p_value_of and any(t.cause == "torque_offset" for t in replacement):
                    continue
                simple = fit_terms(design, rest + replacement)
                if not all(is_physical(simple, t) for t in replacement):
                    continue
                quiet = axes_at_noise(design, simple)[_axes_of(term)].all()
                if quiet or not is_needed(design, simple, current):
                    current, terms, changed = simple, rest + replacement, True
                    break
            if changed:
                break
    return current, terms
