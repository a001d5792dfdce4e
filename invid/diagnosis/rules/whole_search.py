"""Records taken whole, searched against every axis' friction.

Every joint rubs. Here the friction of every motor is in the hypothesis from the start, in one fit, with its
own width of reversal, its rise at slow speed and its difference between the directions
(``invid.effects.laws.joint``); what else there is is searched against what that leaves. Which parts of the
friction are there is told at the end, by their sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from invid.diagnosis.candidates import REACH, screen_candidates
from invid.diagnosis.evidence import (
    CandidateEvidence,
    Step,
    evidence_if_finite,
    fit_if_finite,
    is_at_bound,
    refit_with_effect,
    schwarz_penalty,
)
from invid.diagnosis.score_test import Score, Screen, terms_to_test
from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import HELD_OUT, SHARE, SIGNIFICANCE
from invid.effects.catalogue.asymmetric_friction import AsymmetricStribeck
from invid.effects.laws.joint import JointFriction
from invid.effects.laws.sign import DryLaw
from invid.effects.registry import BY_CAUSE
from invid.likelihood.evaluation import evaluate
from invid.likelihood.joint_fit import JointFit, fit, reorder_effects
from invid.likelihood.null_test import null_test
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.model.place import Place
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.numerics.distributions import chi2_isf
from invid.signals.spectral_record import SpectralRecord

LAW = JointFriction()
TRIED = 3
"""Candidates of a screen that are fitted at most. A guess."""
NEAR = 0.5
"""Share of the best one's gain from which a candidate is fitted. A guess."""
OTHER_FRICTION = ("presliding_friction",)
"""Friction of a motor that the joint's law stands for."""
TIMING = ("torque_delay", "torque_lag")
"""What the time constants and offsets of the drives, free here, stand for."""


def search_beside_friction(
    base: CandidateEvidence,
    known: Candidate,
    start: Float64,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    *,
    linear_axes: bool,
) -> Selection | None:
    """Friction of every motor, and causes beside it; ``None`` where no fit of the friction is finite.

    ``known``: the friction that the identification found with the linear parameters ``start``.
    """
    null = _with_friction(base, known, start, train, held)
    if null is None:
        return None
    found = _Found(null, ())
    cut = False
    try:
        while null_test(found.trial.fit.cost, found.trial.fit.dof, train).rejects:
            more = _further(found, train, held, linear_axes)
            if more is None:
                break
            found = more
    except budget.BudgetSpent:
        cut = True
    return replace(_named(base, null, found, train, held, linear_axes), cut=cut)


@dataclass(frozen=True, eq=False)
class _Found:
    """Where the search stands, and its steps."""

    trial: CandidateEvidence
    steps: tuple[Step, ...]


def _with_friction(
    base: CandidateEvidence,
    known: Candidate,
    start: Float64,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> CandidateEvidence | None:
    """The fit with the friction of every motor, from the parameters that the identification found with some
    of it; those of the fit without were tried beside them and ended no lower."""
    structure = base.fit.layout.structure
    sizes = {(t.effect.cause, t.place): float(x[0]) for t, x in zip(known.terms, known.x, strict=True)}
    candidate = base.fit.candidate
    for axis in range(structure.motors):
        place = Place("mass", axis, 1)
        if any(t.place == place and t.effect.family == "friction" for t in candidate.terms):
            continue
        dry, wet = (sizes.get((c, place), 0.0) for c in ("coulomb_friction", "viscous_friction"))
        (shape,) = LAW.grid(base.fit.evaluation.views, place)
        candidate = candidate.plus(PlacedEffect(LAW, place), np.array([dry, wet, 0.0, 0.0, 0.0, 0.0, *shape]))
    starts = [p for p in (start, base.fit.p) if p.size == base.fit.p.size]
    return evidence_if_finite(partial(fit, base.fit.layout, train, starts[0], candidate, iterations=60), held)


def _further(
    found: _Found, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord], linear_axes: bool
) -> _Found | None:
    """With one cause more, the best of a screen and a few fits; ``None`` where none is there."""
    current = found.trial
    here, rows = current.fit, current.fit.dof
    chosen = here.candidate.terms
    terms = [
        t
        for t in terms_to_test(here.layout.structure, linear_axes=linear_axes, chosen=chosen)
        if t.effect.cause not in (*TIMING, *OTHER_FRICTION)
    ]
    scores = screen_candidates(Screen(here), terms)
    enough = chi2_isf(SIGNIFICANCE / len(terms), 1) * min(here.dispersion, 1.0)
    scores = [s for s in scores if REACH * s.gain >= enough]
    trials = []
    for score in scores[:TRIED]:
        if score.gain < NEAR * scores[0].gain:
            continue
        trial = _fitted(here, score, train, held)
        if trial is not None and not is_at_bound(trial.fit):
            trials.append(trial)
    if not trials:
        return None
    least = min(t.dispersion for t in trials)
    # By the training: how far records of another motion are off is asked below, uncertainty allowed for.
    ranked = sorted(((t, t.fit.cost / least + schwarz_penalty(t, rows)) for t in trials), key=lambda r: r[1])
    best = ranked[0][0]
    needed = chi2_isf(SIGNIFICANCE / len(terms), max(best.term.size, 1))
    needed = max(needed, np.log(max(rows, 2)) * best.term.size)
    gained = here.cost - best.fit.cost
    if gained / best.fit.dispersion < needed or gained < SHARE * (here.cost - here.dof):
        return None
    if (_foreseen(current, held) - _foreseen(best, held)) / best.fit.dispersion < HELD_OUT:
        return None
    steps = (*found.steps, Step(current, best, tuple(ranked)))
    beside = _beside(best, scores, here)
    if beside:
        more = _together(best, beside, train, held)
        if more is not None:
            count = len(best.fit.candidate.terms)
            for n in range(len(beside)):
                order = [*(k for k in range(count + len(beside)) if k != count + n), count + n]
                one = CandidateEvidence(reorder_effects(more.fit, order), more.held)
                steps = (*steps, Step(best, one, ((one, one.cost),)))
            best = more
    return _Found(best, steps)


def _beside(best: CandidateEvidence, scores: Sequence[Score], here: JointFit) -> list[Score]:
    """Ripples of other motors that the same screen shows: each is read from its own motor's motion alone, and
    takes nothing from the other."""
    needed = 2.0 * np.log(max(here.dof, 2)) * max(best.fit.dispersion, 1.0)
    taken, out = {best.term.place}, []
    for s in scores:
        if s.term.effect.cause == "cogging" and s.term.place not in taken and s.gain > 3.0 * needed:
            taken.add(s.term.place)
            out.append(s)
    return out


def _together(
    best: CandidateEvidence,
    beside: Sequence[Score],
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> CandidateEvidence | None:
    """The fit with more causes at once; ``None`` where one of them then has no size."""
    candidate = best.fit.candidate
    for s in beside:
        candidate = candidate.plus(s.term, s.x)
    found = evidence_if_finite(
        partial(fit, best.fit.layout, train, best.fit.p, candidate, iterations=6, quick=True), held
    )
    if found is None:
        return None
    first = len(best.fit.candidate.terms)
    sure = all(_wald(found.fit, first + n) > 1.0 for n in range(len(beside)))
    return found if sure and found.fit.cost < best.fit.cost else None


def _fitted(
    here: JointFit, score: Score, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> CandidateEvidence | None:
    """The joint fit from what the screen promises: near the answer at once, or left there."""
    found = fit_if_finite(partial(refit_with_effect, here, train, score.term, score.x, 6, score.shift))
    return None if found is None else evidence_if_finite(lambda: found, held)


def _foreseen(trial: CandidateEvidence, held: Sequence[SpectralRecord]) -> float:
    """χ² of the held-out records, the parameters as uncertain as the training left them.

    Records of another kind of motion ask for combinations of parameters that the training hardly tells; what
    those are off by is no sign of a wrong law. min over δ of |r + Jδ|² + δᵀC⁻¹δ.
    """
    part = evaluate(trial.fit.layout, held, trial.fit.p, trial.fit.candidate, near=(), jacobian=True)
    information = trial.fit.evaluation.jacobian
    both = np.concatenate((part.jacobian, information))
    scale = np.linalg.norm(both, axis=0)
    scale[scale == 0] = 1.0
    target = np.concatenate((part.residual, np.zeros(information.shape[0])))
    step, *_ = np.linalg.lstsq(both / scale, target, rcond=1e-10)
    left = target - both / scale @ step
    return float(left @ left)


def _named(
    base: CandidateEvidence,
    null: CandidateEvidence,
    found: _Found,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    linear_axes: bool,
) -> Selection:
    """The selection with friction named by its parts, and without what is not told from nothing."""
    known = len(base.fit.candidate.terms)
    final = found.trial
    steps = list(found.steps)
    friction: list[tuple[PlacedEffect, Float64]] = []
    motors = [k for k, t in enumerate(final.fit.candidate.terms) if t.effect is LAW]
    for k in motors:
        friction += _parts(final.fit, k)
    rest = [k for k in range(known, len(final.fit.candidate.terms)) if k not in motors]
    candidate = final.fit.candidate.only(range(known))
    for term, x in friction:
        candidate = candidate.plus(term, x)
    for k in rest:
        candidate = candidate.plus(final.fit.candidate.terms[k], final.fit.candidate.x[k])
    layout = final.fit.layout
    whole = evidence_if_finite(partial(fit, layout, train, final.fit.p, candidate, iterations=30), held)
    if whole is None:
        return Selection(base, base)
    every = [*[Step(base, null, ((null, null.cost),)) for _ in friction], *steps]
    while every:
        sizes = [_wald(whole.fit, known + n) for n in range(len(every))]
        weakest = int(np.argmin(sizes))
        if sizes[weakest] > 1.0:
            break
        fewer = whole.fit.candidate.without(known + weakest)
        other = evidence_if_finite(partial(fit, layout, train, whole.fit.p, fewer, iterations=20), held)
        if other is None:
            break
        whole, every = other, [*every[:weakest], *every[weakest + 1 :]]
    out = []
    for n, step in enumerate(every):
        if step.chosen is null:
            own = _led_by(whole, known + n)
            out.append(Step(base, own, ((own, own.cost),)))
        elif step.chosen.term.effect.family == "position" and step.chosen.term.place.kind == "mass":
            out.append(step)  # a weight, a ripple: read from its own motor's motion
        else:
            whole, step = _exchanged(whole, known + n, step, train, held, linear_axes)
            out.append(step)
    return Selection(base, whole, tuple(out))


def _led_by(trial: CandidateEvidence, at: int) -> CandidateEvidence:
    """The same fit with effect ``at`` as its last one."""
    count = len(trial.fit.candidate.terms)
    return CandidateEvidence(
        reorder_effects(trial.fit, [*(k for k in range(count) if k != at), at]), trial.held
    )


def _exchanged(
    whole: CandidateEvidence,
    at: int,
    step: Step,
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
    linear_axes: bool,
) -> tuple[CandidateEvidence, Step]:
    """A cause against those that it is easily taken for, beside all others: it was chosen while some of them
    were missing."""
    if budget.is_spent():
        return whole, step
    own, here = _led_by(whole, at), whole.fit
    run = partial(fit, here.layout, train, here.p, here.candidate.without(at), iterations=10, quick=True)
    rest = evidence_if_finite(run, held)
    if rest is None:
        return whole, step
    lost, term = rest.fit.cost - here.cost, own.term
    terms = [
        t
        for t in terms_to_test(
            here.layout.structure, linear_axes=linear_axes, chosen=rest.fit.candidate.terms
        )
        if t.effect.cause in (term.effect.cause, *term.effect.looks_like)
        and t.place.axis == term.place.axis
        and (t.effect.cause, t.place) != (term.effect.cause, term.place)
    ]
    scores = [s for s in screen_candidates(Screen(rest.fit), terms) if s.gain > NEAR * lost]
    trials = [_fitted(rest.fit, s, train, held) for s in scores[:TRIED]]
    all_ = [own, *(t for t in trials if t is not None and not is_at_bound(t.fit))]
    least, rows = min(t.fit.dispersion for t in all_), here.dof
    ranked = sorted(
        ((t, t.fit.cost / least + schwarz_penalty(t, rows)) for t in all_),
        key=lambda r: (r[1], r[0] is not own),
    )
    best = ranked[0][0]
    if best is not own:
        count = len(best.fit.candidate.terms)
        order = [*range(at), count - 1, *range(at, count - 1)]
        whole = CandidateEvidence(reorder_effects(best.fit, order), best.held)
    return whole, Step(rest, best, tuple(ranked))


def _wald(found: JointFit, number: int) -> float:
    """Size of an effect's coefficients over what noise makes once in ``SIGNIFICANCE``; infinite for none."""
    term, x = found.candidate.terms[number], found.candidate.x[number]
    count = max(len(term.effect.coefficients), 0)
    if not count:
        return np.inf
    block = found.covariance_of(number)
    if not np.isfinite(block).all():
        block = block[:count, :count]
        if not np.isfinite(block).all():
            return 0.0
    scale = np.sqrt(np.maximum(np.diag(block), 1e-300))
    information = np.linalg.pinv(block / scale[:, None] / scale, hermitian=True)[:count, :count]
    size = x[:count] / scale[:count]
    return float(size @ information @ size) / chi2_isf(SIGNIFICANCE, count)


def _parts(found: JointFit, number: int) -> list[tuple[PlacedEffect, Float64]]:
    """The catalogue's laws that a motor's friction consists of, with their sizes."""
    x, covariance = found.candidate.x[number], found.covariance_of(number)
    place = found.candidate.terms[number].place
    dry, wet, slow, uneven, uneven_wet, uneven_slow = (float(v) for v in x[:6])
    velocity, width = float(x[6]), float(np.exp(x[7]))

    def there(parts: list[int], chance: float = SIGNIFICANCE) -> bool:
        block = covariance[np.ix_(parts, parts)]
        if not np.isfinite(block).all():
            return False
        return float(x[parts] @ np.linalg.lstsq(block, x[parts], rcond=None)[0]) > chi2_isf(
            chance, len(parts)
        )

    sticks = there([2])
    if there([3, 4]):
        law = _dry("asymmetric_friction")
        size = [dry + uneven, dry - uneven, wet + uneven_wet, wet - uneven_wet]
        shape: list[float] = []
        if sticks:
            law = AsymmetricStribeck()
            size, shape = [*size, slow + uneven_slow, slow - uneven_slow], [velocity]
        return [(PlacedEffect(law.rounded(width), place), np.array([*np.maximum(size, 0.0), *shape]))]
    out = []
    if sticks:
        law = _dry("stribeck_friction")
        out.append((PlacedEffect(law.rounded(width), place), np.array([dry, slow, velocity])))
    elif there([0]):
        out.append((PlacedEffect(_dry("coulomb_friction").rounded(width), place), np.array([dry])))
    if there([1]):
        out.append((PlacedEffect(BY_CAUSE["viscous_friction"], place), np.array([wet])))
    return out


def _dry(cause: str) -> DryLaw:
    law = BY_CAUSE[cause]
    assert isinstance(law, DryLaw)  # noqa: S101 - the catalogue's friction
    return law
