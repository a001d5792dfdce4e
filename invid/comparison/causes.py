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
side's other numbers to √(1 + z²) deviations: friction at the same place (``pairs.width``), and the chain of
the axis where the cause itself cannot be told (``variance_factors``).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import special

from invid.comparison.changes import CauseChange, CauseStatus, Change, Repeatability, Status
from invid.comparison.joint_test import two_sided
from invid.comparison.pairs import describe, is_friction, name_of, named_effects, width
from invid.comparison.sentences import bound_phrase
from invid.effects.registry import BY_CAUSE
from invid.model.document import EffectTerm, Estimate, Model
from invid.numerics.distributions import chi2_isf, normal_isf
from invid.wording.clauses import cause_name
from invid.wording.figures import differing_number
from invid.wording.statement import Figure, Statement

NAMED_FROM = math.sqrt(chi2_isf(1e-5, 1))
"""Size, in standard deviations, from which a diagnosis names a cause: a chance of one in a thousand over
about a hundred candidates (``invid.diagnosis.acceptance``)."""
_SEEN = NAMED_FROM + normal_isf(0.05)
"""Size that is named in 95 of 100 runs."""


CHANGED = (CauseStatus.APPEARED, CauseStatus.GREW, CauseStatus.SHRANK, CauseStatus.GONE)


def main_parameter(term: EffectTerm) -> str | None:
    """Name of the parameter that is an effect's size."""
    effect = BY_CAUSE.get(term.cause)
    if effect is not None and effect.main in term.parameters:
        return effect.main
    return next(iter(term.parameters), None)


def compare_causes(
    old: Model,
    new: Model,
    common: Sequence[str],
    *,
    alpha: float,
    tolerance: float,
    scatter: Repeatability | None = None,
) -> tuple[CauseChange, ...]:
    """Compare every cause that one of two models has on their common axes (see ``compare``)."""
    scatter = Repeatability() if scatter is None else scatter
    before, after = (named_effects(m, common) for m in (old, new))
    found: list[CauseChange] = []
    for name in dict.fromkeys([*before, *after]):
        was, now = before.get(name), after.get(name)
        twin = None
        if now is None and was is not None:
            if _same_place(was, after.values(), before) is not None:
                continue  # told of the law that describes it now
        elif was is None and now is not None:
            twin = _same_place(now, before.values(), after)
        change = _paired(name, was, now, twin)
        if change.why is None and (was is None or now is None):
            change = _one_sided(change, (old, new), scatter)
        elif change.why is None:
            change = _two_sided(change, (width(name, before, after), width(name, after, before)), scatter)
        found.append(change)
    return _judged(found, alpha, tolerance)


def _paired(
    name: str, was: EffectTerm | None, now: EffectTerm | None, twin: EffectTerm | None
) -> CauseChange:
    """One cause with the estimates of both sides, or why it cannot be told."""
    term = now if now is not None else was
    if term is None:
        raise ValueError(f"{name}: neither model has it")
    parameter = main_parameter(term) or ""
    a, b = (None if t is None else t.parameters.get(parameter) for t in (was, now))
    unit = (b or a or Estimate(0.0)).unit
    change = CauseChange(
        name,
        term.cause,
        term.axis,
        term.element,
        term.other_axis,
        parameter,
        unit,
        f"{term.axis}: {describe(term)}",
        a,
        b,
        CauseStatus.CANNOT_TELL,
    )
    if twin is not None:
        return replace(change, why=Statement("why.described", {"cause": cause_name(twin.cause)}))
    if any(e is not None and not (e.std is not None and e.std > 0) for e in (a, b)) or (
        a is None and b is None
    ):
        return replace(change, why=Statement("why.cause_no_std"))
    return change


def _two_sided(change: CauseChange, widths: tuple[float, float], scatter: Repeatability) -> CauseChange:
    """A cause that both runs found, by its size; ``widths``: of its deviation on either side."""
    a, b = change.old, change.new
    if a is None or b is None:
        return change
    if not math.isfinite(max(widths)):
        return replace(change, why=Statement("why.other_law"))
    spread = [
        math.hypot(w * (e.std or 0.0), scatter.relative * e.value)
        for w, e in zip(widths, (a, b), strict=True)
    ]
    std = scatter.factor * math.hypot(*spread)
    p = two_sided((b.value - a.value) / std, scatter.dof)
    nothing = _nothing(change.parameter)
    size = abs(b.value - nothing) - abs(a.value - nothing)
    return replace(change, difference=size, std=std, p_value=p)


def _nothing(parameter: str) -> float:
    """The value at which a cause is none."""
    return 1.0 if parameter == "gain" else 0.0


def _one_sided(change: CauseChange, models: tuple[Model, Model], scatter: Repeatability) -> CauseChange:
    """A cause that one run alone found, against what the other could have seen."""
    mine, other = (1, 0) if change.old is None else (0, 1)
    found = change.new if change.old is None else change.old
    if found is None or found.std is None:
        return change
    which = "old" if other == 0 else "new"
    doubt = _not_looked_for(models[other], which)
    ratio = None if doubt else noise_ratio(models[mine], models[other], change.axis)
    if ratio is None:
        return replace(change, why=doubt or Statement(f"why.sight_unknown_{which}"))
    own = scatter.factor * math.hypot(found.std, scatter.relative * found.value)
    theirs = max(ratio, 1e-9) * scatter.factor * found.std
    size = abs(found.value - _nothing(change.parameter))
    x = np.linspace(0.0, size + 6 * own, 400)
    p = float(np.max(special.ndtr(NAMED_FROM - x / theirs) * special.ndtr((x - size) / own)))
    sign = 1.0 if mine == 1 else -1.0
    return replace(
        change, difference=sign * size, std=math.hypot(own, theirs), p_value=p, detectable=_SEEN * theirs
    )


def _not_looked_for(model: Model, which: str) -> Statement | None:
    """Why a cause may be missing in a model without being absent; ``None`` where nothing says so."""
    verdict = model.fit.get("verdict")
    if model.fit.get("search_cut_short"):
        return Statement(f"why.cut_short_{which}")
    if verdict in ("consistent", "explained") or (verdict is None and model.effects):
        return None
    return Statement(f"why.not_looked_{which}" if verdict is None else f"why.nameless_{which}")


def noise_ratio(mine: Model, other: Model, axis: str) -> float | None:
    """Standard deviations of the other run over mine, relative, median over masses and springs of an axis."""
    i, j = mine.axes.index(axis), other.axes.index(axis)
    ratios: list[float] = []
    for own, theirs, a, b in (
        (mine.std.masses[i], other.std.masses[j], mine.chains.masses[i], other.chains.masses[j]),
        (mine.std.springs[i], other.std.springs[j], mine.chains.springs[i], other.chains.springs[j]),
    ):
        if own.size == theirs.size:
            ratios += [float(x) for x in (theirs / b) / (own / a)]
    known = [r for r in ratios if math.isfinite(r) and r > 0]
    return float(np.median(known)) if known else None


def _same_place(
    term: EffectTerm, others: Iterable[EffectTerm], own: Mapping[str, EffectTerm]
) -> EffectTerm | None:
    """Another kind of friction at the same place, that this side does not have too."""
    for other in others:
        if (
            name_of(other) not in own
            and (other.axis, other.element) == (term.axis, term.element)
            and is_friction(other)
            and is_friction(term)
        ):
            return other
    return None


def variance_factors(causes: Sequence[CauseChange]) -> tuple[dict[str, float], dict[str, float]]:
    """By axis how many times the variance of its chain counts, in the old and in the new model: 1 + z² beside
    causes of z deviations of which nothing tells whether the other has them."""
    factors: tuple[dict[str, float], dict[str, float]] = {}, {}
    for c in causes:
        for side, own, other in zip(factors, (c.old, c.new), (c.new, c.old), strict=True):
            if c.status is CauseStatus.CANNOT_TELL and own is not None and own.std and other is None:
                z = (own.value - _nothing(c.parameter)) / own.std
                side[c.axis] = side.get(c.axis, 1.0) + z**2
    return factors


def _judged(found: Sequence[CauseChange], alpha: float, tolerance: float) -> tuple[CauseChange, ...]:
    """Status of every cause by Holm's step-down procedure over all that can be tested."""
    tested = [k for k, c in enumerate(found) if c.p_value is not None]
    out, running = list(found), 0.0
    for rank, k in enumerate(sorted(tested, key=lambda k: found[k].p_value or 0.0)):
        c = found[k]
        running = max(running, min(1.0, (len(tested) - rank) * (c.p_value or 0.0)))
        out[k] = replace(_status(c, running < alpha, alpha, tolerance), p_adjusted=running)
    return tuple(out)


def _status(c: CauseChange, significant: bool, alpha: float, tolerance: float) -> CauseChange:
    if c.difference is None or c.std is None:
        return c
    if c.old is None or c.new is None:
        status = CauseStatus.APPEARED if c.old is None else CauseStatus.GONE
        if significant and abs(c.difference) >= (c.detectable or 0.0):
            return replace(c, status=status)
        which = "old" if c.old is None else "new"
        size = differing_number(c.detectable or 0.0, (c.detectable or 0.0) / 20)
        unit = f" {c.unit}" if c.unit and c.unit != "1" else ""
        return replace(c, why=Statement(f"why.would_see_{which}", {"size": Figure(f"{size}{unit}")}))
    if significant:
        return replace(c, status=CauseStatus.GREW if c.difference >= 0 else CauseStatus.SHRANK)
    scale = abs(c.old.value)
    bound = (abs(c.difference) + normal_isf(alpha) * c.std) / scale if scale > 0 else None
    if bound is not None and bound <= tolerance:
        return replace(c, status=CauseStatus.UNCHANGED, bound=bound)
    why = Statement("why.cause_was_zero")
    if bound is not None:
        why = Statement("why.unseen", {"bound": bound_phrase(bound)})
    return replace(c, why=why, bound=bound)


def with_cause_verdicts(effects: Sequence[Change], causes: Sequence[CauseChange]) -> tuple[Change, ...]:
    """The parameters of effects, the main one of each as its cause was judged: one number, one verdict."""
    by_name = {f"{c.name}.{c.parameter}": c for c in causes if c.old is not None and c.new is not None}
    words = {CauseStatus.UNCHANGED: Status.UNCHANGED, CauseStatus.CANNOT_TELL: Status.CANNOT_TELL}
    out = []
    for e in effects:
        c = by_name.get(e.name)
        if c is None or c.p_value is None:
            out.append(e)
            continue
        status = words.get(c.status, Status.CHANGED)
        out.append(
            replace(
                e,
                status=status,
                why=c.why,
                std=c.std,
                bound=c.bound,
                p_value=c.p_value,
                p_adjusted=c.p_adjusted,
            )
        )
    return tuple(out)
