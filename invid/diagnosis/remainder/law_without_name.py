"""What no cause of the catalogue explains, as a smooth law: at which place, over which quantity or two.

The law is a spline. Of its shapes only those are fitted that the records see and that nothing else of the
model can stand for: a straight line over a deflection is the spring's, one over a velocity a damper's.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
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
from invid.effects.laws.empirical_law import KNOTS, EmpiricalLaw, is_known, knots_of, most_knots
from invid.effects.motion_effect import OF_MOTION, OF_RATE, PAIRS
from invid.likelihood.joint_fit import JointFit, fit
from invid.likelihood.null_test import rms_torque
from invid.likelihood.placed_effect import PlacedEffect
from invid.model.place import Place
from invid.numerics import budget
from invid.numerics.arrays import Bool, Float64
from invid.numerics.distributions import chi2_isf
from invid.numerics.smooth_parts import smooth_parts
from invid.signals.spectral_record import SpectralRecord

FIRST, FIRST_OF_TWO, ROUNDS = 6, 15, 3
"""Most shapes of a law that is fitted first, over one quantity and over two (all products up to the fourth
order), and how often they are chosen anew (empirical)."""
FITTED = 3
"""Laws of the screen that are fitted jointly (empirical, for the time): the place is told by their fits."""
FLOOR_OF_TWO = 1.5
"""Floors above which a law over two quantities is sought (empirical): its many numbers take minutes."""
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
    """The step that adds the law which takes most; ``None`` where none is significant or takes enough.

    A law over two quantities is sought where one over one does not reach the noise.
    """
    here = current.fit
    structure = here.layout.structure
    loud = {i for i in range(structure.motors) if _is_above_noise(current, i)}
    loud -= {t.place.axis for t in here.candidate.terms if isinstance(t.effect, EmpiricalLaw)}
    if not loud:
        return None
    search = _Search(current, train, held)
    curves = search.scores(loud, [(over, "") for over in OF_MOTION])
    step = search.step(curves)
    if step is not None and not _is_above_noise(step.chosen, step.chosen.term.place.axis):
        return step
    louder = {i for i in loud if _is_above_noise(current, i, FLOOR_OF_TWO)}
    surfaces = search.step(search.promising(search.scores(louder, PAIRS), curves))
    if surfaces is None or not search.beats_curves(surfaces.chosen, curves):
        return step
    rows, dispersion = here.dof, surfaces.chosen.dispersion
    if step is not None and step.chosen.score(dispersion, rows) <= surfaces.chosen.score(dispersion, rows):
        return step
    return surfaces


class _Search:
    """Laws tried beside what explains the records so far."""

    def __init__(
        self, current: CandidateEvidence, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
    ) -> None:
        self._current, self._train, self._held = current, train, held
        self._price = _price(current.fit, current.fit.dispersion)
        self._tried = 0

    def scores(self, loud: Collection[int], quantities: Sequence[tuple[str, str]]) -> list[Score]:
        """Laws over each of these quantities on these axes, best first."""
        here = self._current.fit
        screen, structure = Screen(here), here.layout.structure
        found = [
            score
            for over, across in quantities
            for place in EmpiricalLaw(over, across=across).places(structure)
            if place.axis in loud
            and (
                score := _score(
                    screen, over, across, place, FIRST_OF_TWO if across else FIRST, here.dispersion
                )
            )
            is not None
        ]
        screen.restore_views()
        self._tried += len(found)
        return sorted(found, key=lambda s: s.size * self._price - s.gain)

    def step(self, scores: Sequence[Score]) -> Step | None:
        """The step that adds the best law; ``None`` where it is not significant or does not take enough."""
        current, here = self._current, self._current.fit
        trials = self._fitted(scores[:FITTED])
        if not trials:
            return None
        dispersion = min(t.dispersion for t in trials)
        ranked = sorted(((t, t.score(dispersion, here.dof)) for t in trials), key=lambda r: r[1])
        best = ranked[0][0]
        gains = (here.cost - best.fit.cost, current.held.cost - best.held.cost)
        least = chi2_isf(SIGNIFICANCE / self._tried, best.term.size)
        if gains[0] < least * best.fit.dispersion or gains[1] < HELD_OUT * best.held_dispersion:
            return None
        is_law = _is_known(best) and _takes_nearly_all(best, current)
        return Step(current, best, tuple(ranked)) if is_law else None

    def promising(self, surfaces: Sequence[Score], curves: Sequence[Score]) -> list[Score]:
        """The laws over two quantities that promise more than those over one at their place, price paid."""

        def worth(s: Score) -> float:
            return s.gain - s.size * self._price

        most = {s.term.place: worth(s) for s in reversed(curves)}
        return [s for s in surfaces if worth(s) > most.get(s.term.place, 0.0)]

    def beats_curves(self, law: CandidateEvidence, curves: Sequence[Score]) -> bool:
        """Whether the laws over one quantity at its place explain less, in training and kept out records."""
        rows = self._current.fit.dof
        return all(
            law.score(law.dispersion, rows) < curve.score(law.dispersion, rows)
            and curve.held.cost - law.held.cost >= HELD_OUT * law.held_dispersion
            for curve in self._fitted([s for s in curves if s.term.place == law.term.place])
        )

    def _fitted(self, scores: Sequence[Score]) -> list[CandidateEvidence]:
        fits = (_fit_law(self._current.fit, s, self._train, self._held) for s in scores)
        return [t for t in fits if t is not None]


def _is_above_noise(current: CandidateEvidence, axis: int, times: float = FLOOR) -> bool:
    after, floor = rms_torque(current.held, axis)
    return after > times * floor


def _is_known(best: CandidateEvidence) -> bool:
    """Whether its records tell a law from the rest of the model."""
    law, place = best.term.effect, best.term.place
    if not isinstance(law, EmpiricalLaw):
        return False
    felt = np.concatenate([law.law(v, place, ()) for v in best.fit.evaluation.views])
    return is_known(felt, best.x, best.fit.covariance_of(-1))


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
        law = score.term.effect
        again = _score(screen, law.over, law.across, score.term.place, KNOTS, at.dispersion)
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


def _is_undone(felt: Float64, straight: Float64, law: Float64, dispersion: float) -> Bool:
    """(s,) whether straight parts (k, s), ``felt`` (m, s) in rows beside the rest of the model, are
    known to no third of a ``law`` (k,)."""
    size = np.maximum(np.linalg.norm(felt, axis=0), 1e-300)
    std = np.sqrt(dispersion) * np.abs(straight).max(axis=0) / size
    out: Bool = 3.0 * std > np.abs(law).max()
    return out


def _score(
    screen: Screen, over: str, across: str, place: Place, most: int, dispersion: float
) -> Score | None:
    """The law over one quantity or two at one place with the shapes that pay their price, ``most`` at most;
    ``None`` for none. It has no straight part where the rest of the model can undo that."""
    price = _price(screen.fit, dispersion)
    pattern = place.pattern(screen.fit.layout.structure)
    screen.reconstruct(PlacedEffect(EmpiricalLaw(over, across=across), place))
    quantities = (over, across) if across else (over,)
    knots = []
    for q in quantities:
        waves = [v.velocity(pattern) if q in OF_RATE else v.wave(pattern) for v in screen.views]
        own = knots_of(waves, most_knots(q, two=bool(across)))
        if own is None:
            return None
        knots.append(own)
    first, second = knots[0], knots[1] if across else [0.0]
    law = EmpiricalLaw(over, first, np.eye(len(first) * len(second)), across, second)
    columns = screen.project([law.basis(v, place, ()) for v in screen.views])
    if not np.isfinite(columns).all():
        return None

    def parts_without(straight: Float64) -> tuple[Float64, Float64]:
        rest = columns - (columns @ straight) @ straight.T
        return smooth_parts(rest, -screen.residual, price, most, len(second))

    straight = law.straight()
    shapes, x = parts_without(straight)
    # The stiffness and damper of a spring take it up, whatever it is read from, and so does viscous friction.
    known = [t for t in screen.fit.candidate.terms if t.place == place]
    is_damped = over in OF_RATE and any(t.effect.cause == "viscous_friction" for t in known)
    if place.kind != "spring" and (across or not is_damped):
        if not x.size:
            shapes, x = parts_without(straight[:, :0])
        # Beside what bends: a straight part that a damper undoes may be as large as it likes.
        undone = _is_undone(columns @ straight, straight, shapes @ x, dispersion)
        shapes, x = parts_without(straight[:, undone])
    if not x.size:
        return None
    term = PlacedEffect(EmpiricalLaw(over, first, shapes, across, second), place)
    return Score(term, x, float(x @ x), screen.shift(term, x))
