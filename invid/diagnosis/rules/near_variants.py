"""Rules: variants of a candidate that the screen may not offer; each is fitted beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from invid.diagnosis.evidence import (
    CandidateEvidence,
    Step,
    evidence_if_finite,
    fit_if_finite,
    is_at_bound,
)
from invid.diagnosis.score_test import terms_to_test
from invid.diagnosis.thresholds import CLOSE, COMPETES
from invid.effects.laws.sign import DryLaw
from invid.effects.registry import BY_CAUSE
from invid.likelihood.candidate_pool import map_candidates
from invid.likelihood.joint_fit import JointFit, fit, reorder_effects
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.model.parameters import ChainStructure
from invid.model.place import Place
from invid.numerics.arrays import Float64
from invid.signals.spectral_record import SpectralRecord

MOST_LOST = 0.1
"""Share of the gain of asymmetric friction that a smaller model may lack after a quick fit and still be
fitted fully. Empirical; quick fits end within a few per cent."""


def friction_ladder(
    step: Step, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> tuple[Step, ...]:
    """Asymmetric friction and the symmetric laws at its place, fitted and compared, as steps.

    Four parameters against Coulomb and viscous friction (two), Stribeck or presliding and viscous (four),
    each as two causes; and against Coulomb friction and a constant torque, which together are asymmetric dry
    friction, without or with viscous friction. The cheapest after the penalty is the answer; where the four
    parameters are needed the step is returned with those that are nearly as good as rivals. Empty where
    nothing of this applies.
    """
    if step.chosen.term.effect.cause != "asymmetric_friction":
        return ()
    here = step.chosen.fit
    rows, dispersion = here.dof, step.chosen.dispersion
    asymmetric = limit = step.chosen.score(dispersion, rows)
    best: CandidateEvidence | None = None
    rivals_beside: list[tuple[CandidateEvidence, float]] = []
    options = _symmetric_options(step.chosen)
    # At least what the fewer parameters may cost, and the difference up to which a rival counts.
    fewer = (2.0 * float(np.log(max(rows, 2))) + COMPETES) * dispersion
    most_cost = here.cost + max(MOST_LOST * (step.before.fit.cost - here.cost), fewer)

    def fit_option(option: tuple[tuple[PlacedEffect, ...], tuple[Float64, ...]]) -> CandidateEvidence | None:
        terms, x = option
        candidate = Candidate((*here.candidate.terms[:-1], *terms), (*here.candidate.x[:-1], *x))
        near = fit_if_finite(partial(fit, here.layout, train, here.p, candidate, iterations=10, quick=True))
        if near is None or near.cost > most_cost:
            return None
        return evidence_if_finite(
            partial(fit, near.layout, train, near.p, near.candidate, iterations=20), held
        )

    trials = map_candidates(fit_option, options, here, [*train, *held])
    for (terms, _), trial in zip(options, trials, strict=True):
        if trial is None:
            continue
        score = trial.score(dispersion, rows)
        if any(t.effect.cause == "torque_offset" for t in terms):
            score += extended_schwarz_penalty(trial.fit.layout.structure)
            rivals_beside.append(
                (
                    _move_to_end(trial, len(here.candidate.terms)),
                    step.ranked[0][1] + score - asymmetric,
                )
            )
        if score < limit:
            limit, best = score, trial
    if best is None:
        # Friction that two causes make nearly as well is no certain one.
        return (step.with_rivals(rivals_beside),) if rivals_beside else (step,)
    place = step.chosen.term.place
    kept = [(t, s) for t, s in step.ranked if t.term.place != place]
    steps: list[Step] = []
    first, count = len(here.candidate.terms) - 1, len(best.fit.candidate.terms)
    for size in range(first + 1, count + 1):
        trial = best if size == count else _fit_first_effects(best, size, train, held)
        before = steps[-1].chosen if steps else step.before
        if trial is None:
            return ()
        rivals = [(step.chosen, asymmetric), *kept] if not steps else []
        steps.append(Step(before, trial, ((trial, limit), *rivals)))
    return tuple(steps)


def _move_to_end(trial: CandidateEvidence, at: int) -> CandidateEvidence:
    """The same fit with effect ``at`` moved to the end, which names the candidate."""
    count = len(trial.fit.candidate.terms)
    order = [*(k for k in range(count) if k != at), at]
    return CandidateEvidence(reorder_effects(trial.fit, order), trial.held)


def extended_schwarz_penalty(structure: ChainStructure) -> float:
    """Penalty of one cause more among every cause at every place: −2 ln of its share (Chen and Chen 2008).

    A constant torque beside friction is a second cause; asymmetric friction is one.
    """
    return 2.0 * float(np.log(len(terms_to_test(structure, linear_axes=False))))


def _symmetric_options(
    chosen: CandidateEvidence,
) -> list[tuple[tuple[PlacedEffect, ...], tuple[Float64, ...]]]:
    """Pairs and triples of symmetric causes, with starts, that together may be the asymmetric friction
    chosen."""
    place, x, rounded = chosen.term.place, chosen.x, chosen.term.effect
    dry, wet, constant = 0.5 * float(x[0] + x[1]), 0.5 * float(x[2] + x[3]), 0.5 * float(x[0] - x[1])
    if dry <= 0:
        return []
    views, viscous = chosen.fit.evaluation.views, PlacedEffect(BY_CAUSE["viscous_friction"], place)
    offset = PlacedEffect(BY_CAUSE["torque_offset"], Place("mass", place.axis, 1))
    out: list[tuple[tuple[PlacedEffect, ...], tuple[Float64, ...]]] = []
    laws = [BY_CAUSE[c] for c in ("coulomb_friction", "stribeck_friction", "presliding_friction")]
    if isinstance(rounded, DryLaw) and rounded.rounding > 0:
        # The rounding was fitted to a wrong law: with a constant torque none may be needed.
        laws += [law.rounded(rounded.rounding) for law in laws if isinstance(law, DryLaw)]
    for effect in laws:
        cause = effect.cause
        shape = min((abs(g[0]), g) for g in effect.grid(views, place))[1] if effect.shapes else ()
        size = np.array([dry, 0.2 * dry, *shape] if cause == "stribeck_friction" else [dry, *shape])
        law = PlacedEffect(effect, place)
        if wet > 0:
            out.append(((law, viscous), (size, np.array([wet]))))
        if cause == "coulomb_friction" and offset not in chosen.fit.candidate.terms[:-1]:
            # The constant torque first: it is reconsidered beside the others, and may be weight.
            out.append(((offset, law), (np.array([constant]), size)))
            if wet > 0:
                start = (np.array([constant]), size, np.array([wet]))
                out.append(((offset, law, viscous), start))
    return out


def _fit_first_effects(
    trial: CandidateEvidence, count: int, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> CandidateEvidence | None:
    """The fit with the first ``count`` effects alone."""
    whole = trial.fit
    candidate = whole.candidate.only(range(count))
    return evidence_if_finite(partial(fit, whole.layout, train, whole.p, candidate, iterations=12), held)


def try_other_places(
    best: CandidateEvidence,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    terms: Sequence[PlacedEffect],
    tried: Sequence[PlacedEffect],
    *,
    iterations: int = 20,
) -> list[CandidateEvidence]:
    """Fits of the cause of ``best`` at the places of its axis that were not ``tried``.

    The screen ranks the places with linear parameters that the cause itself has biased; where the best leaves
    more than noise, the next mass may be the right one.
    """
    cause, place, here = best.term.effect.cause, best.term.place, best.fit
    known = {t.place for t in tried if t.effect.cause == cause}
    out = []
    for term in terms:
        if term.effect.cause == cause and term.place.axis == place.axis and term.place not in known:
            placed = PlacedEffect(best.term.effect, term.place)
            out.append(Candidate((*here.candidate.terms[:-1], placed), here.candidate.x))

    def fit_at_place(candidate: Candidate) -> CandidateEvidence | None:
        return evidence_if_finite(
            partial(fit, here.layout, train, here.p, candidate, iterations=iterations), held
        )

    trials = map_candidates(fit_at_place, out, here, [*train, *held])
    return [t for t in trials if t is not None and not is_at_bound(t.fit)]


def retime_load_change(
    trial: CandidateEvidence, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> CandidateEvidence:
    """A load change refitted from every time of the grid; other causes are returned unchanged.

    In a training period that is half of one load, half of the other, a small change early and a large one
    late fit alike: the fit ends at either, and a held-out record decides.
    """
    here, term = trial.fit, trial.term
    if term.effect.cause != "payload_change" or trial.held.cost < CLOSE * trial.held.dof:
        return trial
    best = trial
    for (time,) in term.effect.grid([*here.evaluation.views, *trial.held.views], term.place):
        start = replace(here.candidate, x=(*here.candidate.x[:-1], np.array([trial.x[0], time])))
        other = evidence_if_finite(partial(fit, here.layout, train, here.p, start, iterations=20), held)
        if other is not None and other.cost < best.cost:
            best = other
    return best


def delay_variants(
    here: JointFit,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    terms: Sequence[PlacedEffect],
    free: Float64 | None,
) -> list[CandidateEvidence]:
    """Delays of the axes whose time offset is at its bound, started from the fit without that bound."""
    out = []
    for term in terms:
        p = here.p.copy()
        if free is not None and free.size == p.size and not here.candidate.terms:
            p = free.copy()
        known = free if free is not None and free.size == here.p.size else p
        lateness = float(here.layout.delays(known)[term.place.axis])
        layout, kept = here.layout.without_delay([term.place.axis])
        lateness -= float(layout.total_delay(p[kept], train[0])[term.place.axis])
        candidate = here.candidate.plus(term, np.array([lateness]))
        trial = evidence_if_finite(partial(fit, layout, train, p[kept], candidate, iterations=20), held)
        if trial is not None:
            out.append(trial)
    return out
