"""Causes of two models: which appeared, grew, shrank, stayed, went, or cannot be told.

A cause that both models have is compared by its main parameter. One that only one of them has is another
matter: the other run did not report it, which says that it was *small* there, not that it was nothing. The
test asks how probable it is, at best over all true sizes x, that one run reports nothing and the other a size
of x̂ or more:

    p = max over x of  Φ(T − x/σ₂) · Φ((x − x̂)/σ₁)

with σ₁ of the run that found it, σ₂ what the other run would have had (σ₁ times the ratio of the two runs'
standard deviations of the axis' masses and springs: their noise, duration and amplitude) and T the size in
standard deviations from which a diagnosis names a cause. All causes are tested together (Holm).

Which of several laws a run names is a choice, and what it says of the rest moves with it: by at most z of its
own standard deviations where a law of z deviations is left out (Cauchy and Schwarz, whatever their
correlation). So that both sides count with one joint set of causes, what one side alone names widens that
side's other numbers to √(1 + z²) deviations: friction at the same place (``friction_widths``), and the chain
of the axis where the cause itself cannot be told (``variance_factors``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from invid.clauses import cause_name
from invid.comparison.changes import Change, Repeatability, Status
from invid.comparison.joint_test import two_sided
from invid.comparison.numbers import (
    change_of,
    friction_widths,
    other_friction,
    terms_by_name,
    with_difference,
)
from invid.comparison.sentences import bound_phrase
from invid.effects.registry import BY_CAUSE
from invid.model.document import EffectTerm, Model
from invid.model.named_change import ChangeKind
from invid.numerics.distributions import chi2_isf, normal_isf
from invid.wording.figures import differing_number
from invid.wording.sentence import Figure, sentence

NAMED_FROM = math.sqrt(chi2_isf(1e-5, 1))
"""Size, in standard deviations, from which a diagnosis names a cause: a chance of one in a thousand over
about a hundred candidates (``invid.diagnosis.acceptance``)."""
_SEEN = NAMED_FROM + normal_isf(0.05)
"""Size that is named in 95 of 100 runs."""


def main_parameter(term: EffectTerm) -> str | None:
    """Name of the parameter that is an effect's size."""
    effect = BY_CAUSE.get(term.cause)
    if effect is not None and effect.main in term.parameters:
        return effect.main
    return next(iter(term.parameters), None)


def compare_causes(
    old: Model, new: Model, common: Sequence[str], *, alpha: float, tolerance: float, scatter: Repeatability
) -> tuple[Change, ...]:
    """Compare every cause that one of two models has on their common axes (see ``compare``)."""
    sides = before, after = terms_by_name(old, common), terms_by_name(new, common)
    found: list[Change] = []
    for name, term in (before | after).items():
        row = _row(term, before.get(name), after.get(name))
        if name in before and name in after:
            widths = friction_widths(name, sides)
            spoken = with_difference(row, row.old, row.new, widths=widths, relative=scatter.relative)
            found.append(_two_sided(spoken, scatter))
        elif name in after and (twins := other_friction(term, before, after)):
            why = sentence("it was described as {cause} before", cause=cause_name(twins[0].cause))
            found.append(replace(row, why=why))
        elif name in after or not other_friction(term, after, before):
            found.append(_one_sided(row, (old, new), scatter))
        # else it is told of the law that describes it now
    return _judged([_without_deviation(c) for c in found], alpha, tolerance)


def _row(term: EffectTerm, was: EffectTerm | None, now: EffectTerm | None) -> Change:
    """One cause with the estimates of both sides."""
    parameter = main_parameter(term) or ""
    old, new = (None if t is None else t.parameters.get(parameter) for t in (was, now))
    known = new or old
    unit = None if known is None else known.unit
    return replace(change_of(term, ChangeKind.CAUSE), parameter=parameter, old=old, new=new, unit=unit)


def _without_deviation(c: Change) -> Change:
    """Say so of a cause of which a model gives no deviation."""
    sizes = [e for e in (c.old, c.new) if e is not None]
    if sizes and all(e.std is not None and e.std > 0 for e in sizes):
        return c
    return replace(
        c, difference=None, std=None, p_value=None, why=sentence("a model gives no uncertainty for it")
    )


def _two_sided(c: Change, scatter: Repeatability) -> Change:
    """A cause that both runs found, by its size."""
    if c.old is None or c.new is None or c.std is None:
        return replace(c, difference=None)
    std = scatter.factor * c.std
    p = float(two_sided((c.new.value - c.old.value) / std, scatter.dof))
    size = abs(c.new.value - _nothing(c)) - abs(c.old.value - _nothing(c))
    return replace(c, difference=size, std=std, p_value=p)


def _nothing(c: Change) -> float:
    """The value at which a cause is none."""
    return 1.0 if c.parameter == "gain" else 0.0


def _one_sided(change: Change, models: tuple[Model, Model], scatter: Repeatability) -> Change:
    """A cause that one run alone found, against what the other could have seen."""
    found = change.new or change.old
    if found is None or not found.std:
        return change
    mine, other, which = (*models[::-1], "old") if change.old is None else (*models, "new")
    why = _not_looked_for(other, which)
    ratio = noise_ratio(mine, other, change.axis)
    if why is not None or ratio is None:
        return replace(change, why=why or _UNKNOWN_SIGHT[which])
    own = scatter.factor * math.hypot(found.std, scatter.relative * found.value)
    theirs = max(ratio, 1e-9) * scatter.factor * found.std
    size = abs(found.value - _nothing(change))
    x = np.linspace(0.0, size + 6 * own, 400)
    p = float(np.max(special.ndtr(NAMED_FROM - x / theirs) * special.ndtr((x - size) / own)))
    return replace(
        change,
        difference=size if change.old is None else -size,
        std=math.hypot(own, theirs),
        p_value=p,
        detectable=_SEEN * theirs,
    )


_UNKNOWN_SIGHT = {
    "old": sentence("what the old run could have seen is not known"),
    "new": sentence("what the new run could have seen is not known"),
}
_CUT_SHORT = {
    "old": sentence("the search of the old run ran out of time"),
    "new": sentence("the search of the new run ran out of time"),
}
_NOT_LOOKED = {
    "old": sentence("the old model does not say that causes were looked for"),
    "new": sentence("the new model does not say that causes were looked for"),
}
_NAMELESS = {
    "old": sentence("something in the old run had no name; it may have been this"),
    "new": sentence("something in the new run had no name; it may have been this"),
}


def _not_looked_for(model: Model, which: str) -> str | None:
    """Why a cause may be missing in a model without being absent; ``None`` where nothing says so."""
    verdict = model.fit.get("verdict")
    if model.fit.get("search_cut_short"):
        return _CUT_SHORT[which]
    if verdict in ("consistent", "explained") or (verdict is None and model.effects):
        return None
    return (_NOT_LOOKED if verdict is None else _NAMELESS)[which]


def noise_ratio(mine: Model, other: Model, axis: str) -> float | None:
    """Standard deviations of the other run over mine, relative, median over masses and springs of an axis."""
    i, j = mine.axes.index(axis), other.axes.index(axis)
    ratios: list[float] = []
    for kind in ("masses", "springs"):
        own, theirs = (
            getattr(m.std, kind)[k] / getattr(m.chains, kind)[k] for m, k in ((mine, i), (other, j))
        )
        if own.size == theirs.size:
            ratios += [float(r) for r in theirs / own if math.isfinite(r) and r > 0]
    return float(np.median(ratios)) if ratios else None


def variance_factors(causes: Sequence[Change]) -> tuple[dict[str, float], dict[str, float]]:
    """By axis how many times the variance of its chain counts, in the old and in the new model: 1 + z² beside
    causes of z deviations of which nothing tells whether the other has them."""
    factors: tuple[dict[str, float], dict[str, float]] = {}, {}
    for c in causes:
        for side, own, other in zip(factors, (c.old, c.new), (c.new, c.old), strict=True):
            if c.status is Status.CANNOT_TELL and own is not None and own.std and other is None:
                side[c.axis] = side.get(c.axis, 1.0) + ((own.value - _nothing(c)) / own.std) ** 2
    return factors


def _judged(found: Sequence[Change], alpha: float, tolerance: float) -> tuple[Change, ...]:
    """Status of every cause by Holm's step-down procedure over all that can be tested."""
    tested = [k for k, c in enumerate(found) if c.p_value is not None]
    out, running = list(found), 0.0
    for rank, k in enumerate(sorted(tested, key=lambda k: found[k].p_value or 0.0)):
        running = max(running, min(1.0, (len(tested) - rank) * (found[k].p_value or 0.0)))
        out[k] = _with_status(replace(found[k], p_adjusted=running), running < alpha, alpha, tolerance)
    return tuple(out)


def _with_status(c: Change, is_significant: bool, alpha: float, tolerance: float) -> Change:
    size = c.difference or 0.0
    if c.old is None or c.new is None:
        seen = c.detectable or 0.0
        if is_significant and abs(size) >= seen:
            return _became(c, Status.APPEARED if c.old is None else Status.GONE)
        unit = f" {c.unit}" if c.unit and c.unit != "1" else ""
        text = Figure(f"{differing_number(seen, seen / 20)}{unit}")
        if c.old is None:
            return replace(c, why=sentence("the old run would have seen it from {size} on", size=text))
        return replace(c, why=sentence("the new run would have seen it from {size} on", size=text))
    if is_significant:
        return _became(c, Status.GREW if size >= 0 else Status.SHRANK)
    if not c.scale:
        return replace(c, why=sentence("it was 0"))
    bound = (abs(size) + normal_isf(alpha) * (c.std or 0.0)) / c.scale
    if bound <= tolerance:
        return replace(c, status=Status.UNCHANGED, bound=bound)
    return replace(
        c, why=sentence("a change of up to {bound} would not be seen", bound=bound_phrase(bound)), bound=bound
    )


def _became(c: Change, status: Status) -> Change:
    share = (c.difference or 0.0) / abs(c.old.value) if c.old is not None and c.old.value else None
    return replace(c, status=status, kind=ChangeKind(status), share=share)


def with_cause_verdicts(effects: Sequence[Change], causes: Sequence[Change]) -> tuple[Change, ...]:
    """The parameters of effects, the main one of each as its cause was judged: one number, one verdict."""
    judged = {f"{c.name}.{c.parameter}": c for c in causes if c.old and c.new and c.p_value is not None}
    return tuple(
        replace(
            e,
            status=Status.CHANGED if c.status.is_change else c.status,
            why=c.why,
            std=c.std,
            bound=c.bound,
            p_value=c.p_value,
            p_adjusted=c.p_adjusted,
        )
        if (c := judged.get(e.name)) is not None
        else e
        for e in effects
    )
