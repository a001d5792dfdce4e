"""One candidate with its joint fit and its held-out records, and how such a fit is started."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np

from invid.effects.catalogue.extra_mode import is_frequency_known
from invid.effects.motion import View
from invid.likelihood.evaluation import Evaluation, count_per_line, evaluate
from invid.likelihood.hypothesis import Layout
from invid.likelihood.joint_fit import JointFit, evaluate_held_out, fit, pack, parameter_bounds, unpack
from invid.likelihood.null_test import null_test
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.numerics import budget
from invid.numerics.arrays import Bool, Float64
from invid.numerics.distributions import chi2_isf
from invid.numerics.levenberg_marquardt import LARGEST_STEP
from invid.signals.spectral_record import SpectralRecord

MODES = ("extra_mode", "base_compliance")
"""Causes that put a resonance beside the chains, on any axis that couples."""


def excess_chi2(part: Evaluation, axes: Collection[int], *, moving: bool = False) -> float:
    """χ² beyond its expectation in the missing torque of the axes; ``moving``: without lines at 0 Hz."""
    chosen, out = sorted(axes), 0.0
    for view, root, missing in zip(part.views, part.roots, part.missing, strict=True):
        white = np.abs(np.einsum("fij,fj->fi", root, missing)) ** 2
        rows, static_lines = count_per_line(view.record, root), view.record.omega == 0.0
        used = ~static_lines if moving else np.ones(static_lines.size, dtype=bool)
        out += float((white[:, chosen] - rows[:, None])[used].sum())
    return out


@dataclass(frozen=True, eq=False)
class CandidateEvidence:
    """One candidate: its joint fit to the training records, and the held-out records under that fit."""

    fit: JointFit
    held: Evaluation

    @property
    def term(self) -> PlacedEffect:
        """The effect added last."""
        return self.fit.candidate.terms[-1]

    @property
    def x(self) -> Float64:
        """(k,) parameters of the effect added last."""
        return self.fit.candidate.x[-1]

    @property
    def cost(self) -> float:
        """χ² of training and held-out records together."""
        return self.fit.cost + self.held.cost

    @property
    def dof(self) -> int:
        """Degrees of freedom of training and held-out records together."""
        return self.fit.dof + self.held.dof

    @property
    def excess(self) -> float:
        """χ² minus its expectation; negative where chance made it small."""
        return self.cost - self.dof

    def excess_on(self, axes: Collection[int]) -> float:
        """χ² beyond its expectation in the missing torque of the axes."""
        return sum(excess_chi2(part, axes) for part in (self.fit.evaluation, self.held))

    @property
    def excess_in_motion(self) -> float:
        """χ² beyond its expectation in all torque that is not constant over its record."""
        every = range(self.fit.layout.structure.motors)
        return sum(excess_chi2(part, every, moving=True) for part in (self.fit.evaluation, self.held))

    @property
    def beyond_noise(self) -> float:
        """χ² beyond noise: the excess less three standard deviations of χ², at least zero.

        Likelihoods compare models of which one is true. Where even the final model leaves an excess, the
        models are wrong by something of that size, and a smaller difference between two causes decides
        nothing.
        """
        return max(float(self.excess - 3.0 * np.sqrt(2.0 * self.dof)), 0.0)

    @property
    def starts(self) -> int:
        """Number of initial states of effects with memory, over all records."""
        return sum(len(v.starts) for part in (self.fit.evaluation, self.held) for v in part.views)

    @property
    def dispersion(self) -> float:
        """χ²/ν of training and held-out records together, at least 1."""
        return max(1.0, self.cost / self.dof)

    def rejects(self, records: Sequence[SpectralRecord]) -> bool:
        """Whether the null test rejects it on ``records``, training and held-out together."""
        return null_test(self.cost, self.dof, records).rejects

    @property
    def held_dispersion(self) -> float:
        """χ²/ν of the held-out records, at least 1."""
        return max(1.0, self.held.cost / max(self.held.dof, 1))

    def score(self, dispersion: float, rows: int) -> float:
        """−2 ln(likelihood) with Schwarz' penalty of all effects; candidates are ranked by it."""
        return self.cost / dispersion + schwarz_penalty(self, rows)


@dataclass(frozen=True, eq=False)
class Step:
    """One cause added: the fit before, the chosen one, and its competitors, best first."""

    before: CandidateEvidence
    chosen: CandidateEvidence
    ranked: tuple[tuple[CandidateEvidence, float], ...]
    """Candidates with −2 ln(likelihood)/dispersion + penalty, best first."""
    share: float = 1.0
    """Of what is gained between the two fits, where several causes were added at once."""

    @property
    def gain(self) -> float:
        """Decrease of χ² that is this cause's own."""
        return self.share * (self.before.cost - self.chosen.cost)

    def with_rivals(self, rivals: Sequence[tuple[CandidateEvidence, float]]) -> Step:
        """The step with further competitors; the chosen candidate stays first."""
        others = sorted((*self.ranked[1:], *rivals), key=lambda r: r[1])
        return replace(self, ranked=(self.ranked[0], *others))


class _HasCost(Protocol):
    @property
    def cost(self) -> float: ...


T = TypeVar("T", bound=_HasCost)


def fit_if_finite(run: Callable[[], T], *, always: bool = False) -> T | None:
    """What ``run`` fits; ``None`` where its start leads to nothing finite. ``always``: without time, too.

    Raises
    ------
    BudgetSpent
        No time is left to begin.
    """
    if not always:
        budget.check()
    with np.errstate(all="ignore"):
        try:
            out = run()
        except np.linalg.LinAlgError:
            return None
    return out if np.isfinite(out.cost) else None


def evidence_if_finite(
    run: Callable[[], JointFit],
    held: Sequence[SpectralRecord],
    near: Sequence[View] = (),
    *,
    always: bool = False,
) -> CandidateEvidence | None:
    """What ``run`` fits, evaluated on the held-out records (from the inner motion of the views ``near``);
    ``None`` where its start leads to nothing finite. ``always``: without time, too.

    Raises
    ------
    BudgetSpent
        No time is left to begin.
    """

    def trial() -> CandidateEvidence:
        found = run()
        return CandidateEvidence(found, evaluate_held_out(found, held, near=near))

    return fit_if_finite(trial, always=always)


def refit_with_effect(
    current: JointFit,
    records: Sequence[SpectralRecord],
    term: PlacedEffect,
    x: Float64,
    iterations: int,
    shift: Float64 | None = None,
) -> JointFit:
    """Joint fit with one effect more; ``shift`` (n,): step of the parameters so far that the screen
    predicts."""
    layout, p, candidate, known = _choose_start(current, records, term, x, shift)
    return fit(layout, records, p, candidate, iterations=iterations, quick=True, known=known)


def _choose_start(
    current: JointFit,
    records: Sequence[SpectralRecord],
    term: PlacedEffect,
    x: Float64,
    shift: Float64 | None,
) -> tuple[Layout, Float64, Candidate, Evaluation | None]:
    """Layout, parameters, effects and evaluation where the joint fit starts.

    The cheapest of the screen's joint step, of shares of it, and of shares of the size alone. A strong effect
    biases the linear parameters, so that its size alone makes the fit worse, and a linearised step overshoots
    where the bias is large. The evaluation is ``None`` where none is finite.
    """
    layout, kept = current.layout, np.ones(current.layout.count, dtype=bool)
    if term.effect.cause == "torque_delay":
        layout, kept = layout.without_delay([term.place.axis])
    count = len(term.effect.coefficients)
    best, best_evaluation = np.inf, None
    best_start = layout, current.p[kept], current.candidate.plus(term, x)
    attempts = [(0.0, 1.0), (0.0, 0.4), (0.0, 0.1), (0.0, 0.01)]
    if shift is not None and shift.size and np.isfinite(shift).all():
        attempts = [(1.0, 1.0), (0.5, 1.0), *attempts[:1], (0.4, 0.4), *attempts[1:]]
    low, high = parameter_bounds(current.layout, current.candidate, current.evaluation, True)
    for step, share in attempts:
        moved = pack(current.p, current.candidate)
        if step and shift is not None:
            limit = np.where(_is_logarithmic(current), LARGEST_STEP, np.inf)
            moved = np.clip(moved + np.clip(step * shift, -limit, limit), low, high)
        p, before = unpack(current.layout, current.candidate, moved)
        trial = x.copy()
        trial[:count] *= share
        if not current.layout.structure.admissible(p[: current.layout.structure.count]):
            continue
        candidate = before.plus(term, trial)
        with np.errstate(all="ignore"):
            try:
                evaluation = evaluate(
                    layout, records, p[kept], candidate,
                    jacobian=False, near=current.evaluation.views, limit=best,
                )  # fmt: skip
            except np.linalg.LinAlgError:
                continue
        if np.isfinite(evaluation.cost) and evaluation.cost < best:
            best, best_evaluation, best_start = evaluation.cost, evaluation, (layout, p[kept], candidate)
        if evaluation.cost < current.cost:
            break
    return *best_start, best_evaluation


def _is_logarithmic(current: JointFit) -> Bool:
    """(n,) which parameters of a fit are logarithms."""
    structure, layout = current.layout.structure, current.layout
    flags = [structure.logarithmic, np.zeros(layout.count - structure.count, dtype=bool)]
    for t in current.candidate.terms:
        shapes = np.array(t.effect.logarithmic, dtype=bool)
        flags += [np.zeros(len(t.effect.coefficients), dtype=bool), shapes]
    out: Bool = np.concatenate(flags)
    return out


def is_at_bound(found: JointFit) -> bool:
    """Whether a shape or size of the last effect ends at its bound; the fit then calls for another cause."""
    term, x, views = found.candidate.terms[-1], found.candidate.x[-1], found.evaluation.views
    if term.effect.beyond(views, term.place, x.tolist()):
        return True
    if term.effect.cause == "payload_change":  # time is no part of the size
        return False
    shapes = x[len(term.effect.coefficients) :]
    limits = term.effect.limits(views, term.place)
    if term.effect.cause in MODES:
        # Nor is damping. But a mode outside all lines is none, and one with damping at its bound is friction,
        # or what a hold with other gains leaves (empirical: three of fifteen records without a cause).
        if shapes[1] >= limits[1][1] - 1e-3:
            return True
        variance = float(found.covariance_of(-1)[1, 1])
        if not is_frequency_known(views, float(np.exp(shapes[0])), float(np.sqrt(variance))):
            return True
        shapes, limits = shapes[:1], limits[:1]
    return any(v <= low + 1e-9 or v >= high - 1e-9 for v, (low, high) in zip(shapes, limits, strict=True))


def is_size_significant(found: JointFit, number: int, chance: float = 0.01) -> bool | None:
    """Whether the size of an effect differs from zero (Wald test); ``None`` where its covariance is not
    known."""
    term, x = found.candidate.terms[number], found.candidate.x[number]
    count = len(term.effect.coefficients)
    block = found.covariance_of(number)[:count, :count]
    if not count or not np.isfinite(block).all():
        return None
    wald = float(x[:count] @ np.linalg.lstsq(block, x[:count], rcond=None)[0])
    return wald > chi2_isf(chance, count)


def is_significant_at_shapes(found: JointFit, number: int, chance: float = 0.01) -> bool | None:
    """Whether the size of an effect differs from zero at the shapes that were fitted; ``None`` where not
    known.

    Without the effect there are no shapes, so an uncertain number of cycles, and the phase with it, says
    nothing against the size. Empirical: a gear error with a gain of 215 in χ² had sine and cosine 2.6
    standard deviations from zero.
    """
    term, x = found.candidate.terms[number], found.candidate.x[number]
    count = len(term.effect.coefficients)
    block = found.covariance_of(number)
    if not count or not np.isfinite(block).all():
        return None
    scale = np.sqrt(np.maximum(np.diag(block), 1e-300))
    information = np.linalg.pinv(block / scale[:, None] / scale, hermitian=True)[:count, :count]
    size = x[:count] / scale[:count]
    wald = float(size @ information @ size)
    return wald > chi2_isf(chance, count)


def schwarz_penalty(trial: CandidateEvidence, rows: int) -> float:
    """Schwarz' penalty of the parameters and initial states of all effects, and the rarity of their
    places."""
    terms, structure = trial.fit.candidate.terms, trial.fit.layout.structure
    rare = sum(t.effect.rarity(t.place, structure) for t in terms)
    return float(np.log(max(rows, 2))) * (sum(t.size for t in terms) + trial.starts) + rare


def is_extension_of(larger: CandidateEvidence, smaller: CandidateEvidence) -> bool:
    """Whether ``larger`` is a larger friction model at the same place, which always fits as well as
    ``smaller``."""
    one, other = larger.term, smaller.term
    return (
        one.place == other.place
        and one.effect.family == other.effect.family == "friction"
        and one.size > other.size
    )


def unearned_phase_penalty(trial: CandidateEvidence, rows: int) -> float:
    """Part of Schwarz' penalty to take back for a phase of the last effect that the data hardly determine.

    ln(rows) a parameter is the logarithm of prior over posterior variance with the prior of one row. No phase
    and no order of size is preferred: beside the quadrature c that is seen, the other one is distributed as
    1/(π c (1 + s²/c²)), nowhere as dense as a normal one of variance c²·π/2. Its penalty is the ln(prior over
    posterior variance) of that: nothing where the data do not see it (gravity on a small motion is a constant
    torque), and something where they show that it is zero.
    """
    if trial.term.effect.coefficients != ("sine", "cosine"):
        return 0.0
    block = trial.fit.covariance_of(-1)[:2, :2]
    full_penalty = float(np.log(max(rows, 2)))
    if not np.isfinite(block).all():
        return full_penalty
    variance = float(np.linalg.eigvalsh(block)[-1])
    expected = 0.5 * np.pi * float(trial.x[:2] @ trial.x[:2])
    if variance <= 0.0 or expected <= 0.0:
        return 0.0
    return float(np.clip(full_penalty - np.log(expected / variance), 0.0, full_penalty))
