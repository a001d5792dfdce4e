"""Rule: causes that stand on their own evidence where the rest is not explained: dry friction of a motor.

The search names nothing as long as most is missing, because what a wrong model leaves, any cause may fit. Dry
friction at a motor is the exception. It is read from that motor's measured motion, without inner motion or
linear parameters, and nothing else in the catalogue jumps with the sign of that motion. Where it explains
most of what its axis misses, on held-out records as well, it is there whatever else is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from invid.diagnosis.evidence import (
    CandidateEvidence,
    Step,
    evidence_if_finite,
    excess_chi2,
    is_significant_at_shapes,
)
from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import OWN_RIVAL, OWN_SHARE, WEAK
from invid.likelihood.joint_fit import fit, reorder_effects
from invid.signals.spectral_record import SpectralRecord


def keep_independent_causes(
    found: Selection, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> Selection | None:
    """The selection with only the causes that need no other to be right; ``None`` where there are none.

    The linear model is refitted beside them, and each has to hold against the fit without it.
    """
    known = len(found.base.fit.candidate.terms)
    steps = [n for n, s in enumerate(found.steps) if _is_motor_friction(s) and not _is_contested(s)]
    final, start = found.final.fit, found.base.fit.candidate
    if not steps or final.p.size != found.base.fit.p.size:
        return None
    steps = [n for n in steps if is_significant_at_shapes(final, known + n, WEAK) is not False]
    while steps:
        candidate = start
        for n in steps:
            candidate = candidate.plus(final.candidate.terms[known + n], final.candidate.x[known + n])
        starts = [
            partial(fit, final.layout, train, p, candidate, iterations=25)
            for p in (final.p, found.base.fit.p)
        ]
        trials = [t for t in (evidence_if_finite(run, held) for run in starts) if t is not None]
        if not trials:
            return None
        whole = min(trials, key=lambda t: t.fit.cost)
        bare = [_fit_without(whole, known + k, train, held) for k in range(len(steps))]
        weak = [
            k for k, rest in enumerate(bare) if rest is None or not _is_independent(rest, whole, known + k)
        ]
        if not weak:
            return _selection_of_steps(found, steps, whole, [b for b in bare if b is not None], known)
        steps = [n for k, n in enumerate(steps) if k not in weak]
    return None


def _is_motor_friction(step: Step) -> bool:
    term = step.chosen.term
    at_motor = term.place.kind == "mass" and term.place.number == 1
    return at_motor and "dry" in term.effect.parts


def _is_contested(step: Step) -> bool:
    """Whether a cause of another kind or place explains a large share of what this one does."""
    chosen, gain = step.chosen, step.gain
    return any(
        t.cost - chosen.cost < (1.0 - OWN_RIVAL) * gain
        for t, _ in step.ranked[1:]
        if not (t.term.place == chosen.term.place and t.term.effect.family == "friction")
    )


def _fit_without(
    whole: CandidateEvidence, number: int, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> CandidateEvidence | None:
    """The fit without one cause, everything else refitted."""
    here = whole.fit
    rest = here.candidate.without(number)
    return evidence_if_finite(partial(fit, here.layout, train, here.p, rest, iterations=15), held)


def _is_independent(rest: CandidateEvidence, whole: CandidateEvidence, number: int) -> bool:
    """Whether a cause explains most of what its axis misses without it, in training and held-out records."""
    axis = {whole.fit.candidate.terms[number].place.axis}
    parts = ((rest.fit.evaluation, whole.fit.evaluation), (rest.held, whole.held))
    return all(
        excess_chi2(after, axis) < (1.0 - OWN_SHARE) * excess_chi2(before, axis) for before, after in parts
    )


def _selection_of_steps(
    found: Selection,
    steps: Sequence[int],
    whole: CandidateEvidence,
    bare: Sequence[CandidateEvidence],
    known: int,
) -> Selection:
    """The causes as steps: gain of each beside the others, and its rivals at the same place."""
    out = []
    count = len(whole.fit.candidate.terms)
    for k, (n, rest) in enumerate(zip(steps, bare, strict=True)):
        at = known + k
        chosen = CandidateEvidence(
            reorder_effects(whole.fit, [*(j for j in range(count) if j != at), at]), whole.held
        )
        old = found.steps[n]
        offset = chosen.cost - old.chosen.cost
        rivals = tuple((t, s + offset) for t, s in old.ranked[1:] if t.term.place == chosen.term.place)
        score = old.ranked[0][1] + offset
        out.append(Step(rest, chosen, ((chosen, score), *rivals)))
    return replace(found, final=whole, steps=tuple(out), only_independent=True)
