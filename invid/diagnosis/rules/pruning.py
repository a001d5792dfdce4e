"""Causes found that the others leave nothing to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from invid.diagnosis.evidence import attempted, sized
from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import SIGNIFICANCE, WEAK
from invid.likelihood.joint_fit import JointFit, fit
from invid.numerics.distributions import chi2_isf
from invid.signals.spectral_record import Record


def pruned(found: Selection, train: Sequence[Record], held: Sequence[Record]) -> Selection:
    """Without the causes that the others leave nothing to.

    The first cause named is the one that alone explains most; beside the true ones it may vanish. The last
    may have led linear parameters on that had come to rest too early, and be nothing itself.
    """
    for number in _doubtful(found):
        smaller = _without(found, number, train, held)
        if smaller is not None:
            return pruned(smaller, train, held)
    return found


def _without(
    found: Selection, number: int, train: Sequence[Record], held: Sequence[Record]
) -> Selection | None:
    """One cause less, the others refitted; none where that costs more than the cause's parameters may."""
    final, at = found.final.fit, len(found.base.fit.candidate.terms) + number
    candidate = final.candidate.without(at)

    def less() -> JointFit:
        # Beside a cubic spring a gap of nothing leaves a valley in which the thorough steps alone stand still
        # (seen: χ² 742, where it is 708).
        began = fit(final.layout, train, final.p, candidate, iterations=40, quick=True)
        return fit(final.layout, train, began.p, began.candidate, iterations=40)

    trial = attempted(less, held)
    limit = chi2_isf(SIGNIFICANCE, final.candidate.terms[at].size) * found.final.dispersion
    if trial is None or trial.cost > found.final.cost + limit:
        return None
    steps = list(found.steps)
    gone = steps.pop(number)
    if number < len(steps):
        steps[number] = replace(steps[number], before=gone.before)
    steps[-1] = replace(steps[-1], chosen=trial)
    return replace(found, final=trial, steps=tuple(steps))


def _doubtful(found: Selection) -> list[int]:
    """Steps of several whose cause may be superfluous: its size is not told from none, or it is a shape alone
    (a gap)."""
    final, known = found.final.fit, len(found.base.fit.candidate.terms)
    out: list[int] = []
    for number in range(len(found.steps) if len(found.steps) > 1 else 0):
        term = final.candidate.terms[known + number]
        told = sized(final, known + number, WEAK)
        if told is False or (told is None and not term.effect.coefficients):
            out.append(number)
    return out
