"""What no cause of the catalogue explains, as a smooth law: at which place, over which quantity.

The law is a spline. Of its shapes only those are fitted that the records see and that nothing else of the
model can stand for: a straight line over a deflection is the spring's, one over a velocity a damper's.
"""

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
    refit_with_effect,
)
from invid.diagnosis.score_test import Score, Screen
from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import BROUGHT_DOWN, FLOOR, HELD_OUT, SIGNIFICANCE
from invid.effects.laws.empirical_law import KNOTS, EmpiricalLaw, knots_of
from invid.effects.motion_effect import OF_MOTION, OF_RATE
from invid.likelihood.joint_fit import JointFit, fit
from invid.likelihood.null_test import rms_torque
from invid.likelihood.placed_effect import PlacedEffect
from invid.model.place import Place
from invid.numerics import budget
from invid.numerics.distributions import chi2_isf
from invid.numerics.smooth_parts import smooth_parts
from invid.signals.spectral_record import SpectralRecord

FIRST, ROUNDS = 6, 3
"""Most shapes of a law that is fitted first, and how often they are chosen anew (empirical)."""
FITTED = 3
"""Laws of the screen that are fitted jointly (empirical)."""
ITERATIONS = 12
"""Iterations of a fit with a law (empirical)."""


def add_laws(
    found: Selection, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> Selection | None:
    """The selection with a law for what it leaves, on at most one place of each axis; ``None`` where none
    is significant and takes nearly all that is left on its axis."""
    start = found
    for _ in range(found.final.fit.layout.structure.motors):
        if not found.final.rejects([*train, *held]):
            break
        try:
            step = _find_law(found.final, train, held)
        except budget.BudgetSpent:
            budget.leave_out("a law without a name")
            break
        if step is None:
            break
        found = replace(found, final=step.chosen, steps=(*found.steps, step))
    return None if found is start else found


def _find_law(
    current: CandidateEvidence, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> Step | None:
    """The step that adds the law which takes most; ``None`` where none is significant or takes enough."""
    here = current.fit
    structure, rows = here.layout.structure, here.dof
    loud = {i for i in range(structure.motors) if _is_above_noise(current, i)}
    loud -= {t.place.axis for t in here.candidate.terms if isinstance(t.effect, EmpiricalLaw)}
    if not loud:
        return None
    screen, price = Screen(here), _price(here, here.dispersion)
    scores = [
        score
        for over in OF_MOTION
        for place in EmpiricalLaw(over).places(structure)
        if place.axis in loud and (score := _score(screen, over, place, FIRST, price)) is not None
    ]
    screen.restore_views()
    scores.sort(key=lambda s: s.size * price - s.gain)
    trials = [t for s in scores[:FITTED] if (t := _fit_law(here, s, train, held)) is not None]
    if not trials:
        return None
    dispersion = min(t.dispersion for t in trials)
    ranked = sorted(((t, t.score(dispersion, rows)) for t in trials), key=lambda r: r[1])
    best = ranked[0][0]
    gains = (here.cost - best.fit.cost, current.held.cost - best.held.cost)
    least = chi2_isf(SIGNIFICANCE / max(len(scores), 1), best.term.size)
    if gains[0] < least * best.fit.dispersion or gains[1] < HELD_OUT * best.held_dispersion:
        return None
    table = best.term.effect.table(best.x, best.fit.covariance_of(-1), linear=False)
    is_law = table is not None and table.is_known and _takes_nearly_all(best, current)
    return Step(current, best, tuple(ranked)) if is_law else None


def _is_above_noise(current: CandidateEvidence, axis: int) -> bool:
    after, floor = rms_torque(current.held, axis)
    return after > FLOOR * floor


def _takes_nearly_all(best: CandidateEvidence, current: CandidateEvidence) -> bool:
    """Whether a law brings its axis to the noise, or takes nearly all that is missing there in records kept
    out; what takes less may be a part of any law."""
    axis = best.term.place.axis
    (before, _), (after, floor) = (rms_torque(t.held, axis) for t in (current, best))
    nearly_all = after**2 - floor**2 <= (1.0 - BROUGHT_DOWN) * (before**2 - floor**2)
    return nearly_all or not _is_above_noise(best, axis)


def _fit_law(
    here: JointFit, score: Score, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> CandidateEvidence | None:
    """The joint fit of a law, its shapes chosen anew from where it ends while that is better.

    The parameters beside it were found without it, and so were the first shapes.
    """
    best = evidence_if_finite(
        partial(refit_with_effect, here, train, score.term, score.x, ITERATIONS, score.shift), held
    )
    for _ in range(ROUNDS):
        if best is None:
            break
        at = best.fit
        bare = fit_if_finite(partial(fit, at.layout, train, at.p, here.candidate, iterations=0), always=True)
        if bare is None:
            break
        screen = Screen(bare)
        price = _price(bare, at.dispersion)
        again = _score(screen, score.term.effect.over, score.term.place, KNOTS, price)
        screen.restore_views()
        if again is None:
            break
        run = partial(refit_with_effect, bare, train, again.term, again.x, ITERATIONS, again.shift)
        more = evidence_if_finite(run, held)
        if more is None or more.cost > best.cost - HELD_OUT * best.dispersion:
            break
        best = more
    return best


def _price(here: JointFit, dispersion: float) -> float:
    """Gain of χ² that each shape must bring (Schwarz)."""
    return float(np.log(max(here.dof, 2))) * dispersion


def _score(screen: Screen, over: str, place: Place, most: int, price: float) -> Score | None:
    """The law over one quantity at one place with the shapes that pay their ``price``, ``most`` at most;
    ``None`` for none."""
    pattern = place.pattern(screen.fit.layout.structure)
    screen.reconstruct(PlacedEffect(EmpiricalLaw(over), place))
    waves = [v.velocity(pattern) if over in OF_RATE else v.wave(pattern) for v in screen.views]
    knots = knots_of(waves)
    if knots is None:
        return None
    law = EmpiricalLaw(over, knots, np.eye(len(knots)))
    columns = screen.project([law.basis(v, place, ()) for v in screen.views])
    if not np.isfinite(columns).all():
        return None
    shapes, x = smooth_parts(columns, -screen.residual, price, most)
    if not x.size:
        return None
    term = PlacedEffect(EmpiricalLaw(over, knots, shapes), place)
    return Score(term, x, float(x @ x), screen.shift(term, x))
