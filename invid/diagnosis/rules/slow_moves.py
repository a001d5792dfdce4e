"""Rule: slow moves tell a constant torque, gravity and a ripple apart.

On the small motion of an excitation the three give nearly the same data. A slow move, recorded beside it,
turns the axis far, and one regression of the torque on each law says which of them acts. The chain turns as
one body there, so no spring enters.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from invid.diagnosis.evidence import CandidateEvidence, Step, unearned_phase_penalty
from invid.diagnosis.slow_move import SlowMove, stretch_means
from invid.likelihood.joint_fit import evaluate_held_out, fit, pack, unpack
from invid.numerics.arrays import Float64

SIGN_WIDTH = 0.05
"""Share of a move's top speed within which dry friction changes its sign in the regression (empirical)."""
MOST_DISAGREEMENT = 13.8
"""χ² of two numbers that chance exceeds once in a thousand (statistical)."""


_LAWS: dict[str, Callable[[Float64, float], Float64]] = {
    "torque_offset": lambda q, _: np.ones((q.size, 1)),
    "gravity": lambda q, _: np.stack((np.sin(q), np.cos(q)), axis=1),
    "cogging": lambda q, cycles: np.stack((np.sin(cycles * q), np.cos(cycles * q)), axis=1),
}
"""Columns (samples, L) of the torque of each law at the positions (samples,)."""


def rank_by_slow_moves(step: Step, moves: Sequence[SlowMove]) -> Step:
    """The step with its laws of position ranked by the slow moves as well.

    Only laws on one axis are compared, and only where the best candidate is one. The evidence of n stretches
    is n·ln(residual), because the noise of a move is not known beforehand, with the same penalty a parameter
    as everywhere.
    """
    chosen = step.ranked[0][0]
    if chosen.term.effect.cause not in _LAWS:
        return step
    axis = chosen.term.place.axis
    rivals = [t for t, _ in step.ranked if t.term.effect.cause in _LAWS and t.term.place.axis == axis]
    if len(rivals) < 2:
        return step
    evidence = np.zeros(len(rivals))
    for move in moves:
        evidence += _move_evidence(move, rivals, axis)
    if not np.isfinite(evidence).all() or not evidence.any():
        return step
    score_of_moves = dict(zip(map(id, rivals), 0.5 * (evidence - evidence.min()), strict=True))
    rows = step.before.fit.dof
    ranked = [(t, s + score_of_moves.get(id(t), 0.0)) for t, s in step.ranked]
    ranked.sort(key=lambda one: one[1] - unearned_phase_penalty(one[0], rows))
    if ranked[0][0] not in rivals:  # a cause that has no law here may not win by the moves
        return step
    best = sharpen_gravity(ranked[0][0], moves, axis)
    return replace(step, chosen=best, ranked=((best, ranked[0][1]), *ranked[1:]))


def sharpen_gravity(trial: CandidateEvidence, moves: Sequence[SlowMove], axis: int) -> CandidateEvidence:
    """The trial with the size of gravity combined with that of the moves.

    The excitation sees one direction of its two numbers. Both measurements are weighted by their covariances,
    all other parameters move along (a linear update). Unchanged where the two disagree by more than chance
    does once in a thousand.
    """
    if trial.term.effect.cause != "gravity":
        return trial
    fitted = trial.fit
    whole = pack(fitted.p, fitted.candidate)
    at = slice(whole.size - 2, whole.size)
    covariance = fitted.covariance
    for move in moves:
        columns, rest, found = _regress_move(move, trial, axis)
        spare = rest.size - columns.shape[1]
        if spare < 3 or not np.isfinite(covariance).all():
            continue
        own = 2.0 * float(rest @ rest) / spare * np.linalg.pinv(columns.T @ columns)[-2:, -2:]
        total = covariance[at, at] + own
        gap = found[-2:] - whole[at]
        if float(gap @ np.linalg.solve(total, gap)) > MOST_DISAGREEMENT:
            continue
        gain = np.linalg.solve(total, covariance[at, :]).T
        whole = whole + gain @ gap
        covariance = covariance - gain @ covariance[at, :]
    if covariance is fitted.covariance:
        return trial
    p, candidate = unpack(fitted.layout, fitted.candidate, whole)
    if not fitted.layout.structure.admissible(p[: fitted.layout.structure.count]):
        return trial
    refitted = fit(fitted.layout, fitted.evaluation.records, p, candidate, iterations=0)
    refitted = replace(refitted, covariance=covariance, converged=fitted.converged)
    return CandidateEvidence(refitted, evaluate_held_out(refitted, trial.held.records))


def _move_evidence(move: SlowMove, rivals: Sequence[CandidateEvidence], axis: int) -> Float64:
    """(rivals,) −2 ln(likelihood) of the torque of one axis under each law as the excitation knows it."""
    free = [_regress_move(move, trial, axis) for trial in rivals]
    if any(rest.size < columns.shape[1] + 3 or not rest.any() for columns, rest, _ in free):
        return np.zeros(len(rivals))
    noise = min(float(rest @ rest) / (rest.size - columns.shape[1]) for columns, rest, _ in free)
    return np.array([_move_score(move, trial, axis, noise) for trial in rivals])


def _move_score(move: SlowMove, trial: CandidateEvidence, axis: int, noise: float) -> float:
    """−2 ln(likelihood) of a move under a law whose parameters are only as certain as the excitation knows
    them.

    They are not fitted anew to the move: a constant torque known to a per cent was taken for weight whose two
    parts cancel there by twenty times that. With their covariance Σ the residual of the stretches has the
    covariance noise + L Σ Lᵀ, inertia and friction of the move projected out; the evidence is n·ln(residual),
    because the noise is not known beforehand, and ln(det) of what Σ adds.
    """
    known, torque = _common_columns(move, axis)
    common_basis = np.linalg.qr(known)[0]
    best = np.inf
    for cycles in _possible_cycles(trial):
        law = _law_columns(move, trial, axis, cycles)
        expected, covariance, cycles_chi2 = _predicted_coefficients(trial, cycles)
        law, rest = (v - common_basis @ (common_basis.T @ v) for v in (law, torque - law @ expected))
        total = noise * np.eye(rest.size) + law @ covariance @ law.T
        left = noise * float(rest @ np.linalg.solve(total, rest))
        log_det = float(np.linalg.slogdet(total / noise)[1])
        best = min(best, rest.size * np.log(left) + log_det + cycles_chi2)
    return best


def _predicted_coefficients(trial: CandidateEvidence, cycles: float) -> tuple[Float64, Float64, float]:
    """(L,) coefficients that the excitation predicts, their (L, L) covariance, and χ² of the ``cycles``."""
    count = len(trial.term.effect.coefficients)
    covariance = trial.fit.covariance_of(-1)
    if not np.isfinite(covariance).all():
        # Not seen: as large as the effect may be.
        return np.zeros(count), float(trial.x[:count] @ trial.x[:count]) * np.eye(count), 0.0
    expected, covariance_left = trial.x[:count], covariance[:count, :count]
    if trial.x.size == count:
        return expected, covariance_left, 0.0
    offset = float(np.log(cycles) - trial.x[count])
    slope = covariance[:count, count] / covariance[count, count]
    covariance_left = covariance_left - np.outer(slope, slope) * covariance[count, count]
    return expected + slope * offset, covariance_left, offset**2 / float(covariance[count, count])


def _common_columns(move: SlowMove, axis: int) -> tuple[Float64, Float64]:
    """(n, M + 2) columns of inertia and friction of a move, sizes free, and the torque (n,)."""
    v = move.velocity[:, axis]
    slow = max(SIGN_WIDTH * float(np.abs(v).max()), 1e-300)
    columns = np.concatenate([move.acceleration, np.tanh(v / slow)[:, None], v[:, None]], axis=1)
    return columns, move.torque[:, axis]


def _law_columns(move: SlowMove, trial: CandidateEvidence, axis: int, cycles: float) -> Float64:
    """(n, L) torque of the law for each coefficient at one."""
    return stretch_means(_LAWS[trial.term.effect.cause](move.path[:, axis], cycles), move.rows)


def _regress_move(move: SlowMove, trial: CandidateEvidence, axis: int) -> tuple[Float64, Float64, Float64]:
    """Columns (n, k), residual (n,) and coefficients (k,) of one axis' torque, those of the law last."""
    known, torque = _common_columns(move, axis)
    best: tuple[Float64, Float64, Float64] | None = None
    for cycles in _possible_cycles(trial):
        columns = np.concatenate((known, _law_columns(move, trial, axis, cycles)), axis=1)
        size = np.linalg.norm(columns, axis=0)
        size[size == 0.0] = 1.0
        found = np.linalg.lstsq(columns / size, torque, rcond=1e-9)[0] / size
        rest = torque - columns @ found
        if best is None or float(rest @ rest) < float(best[1] @ best[1]):
            best = columns, rest, found
    return best if best is not None else (np.zeros((0, 0)), np.zeros(0), np.zeros(0))


def _possible_cycles(trial: CandidateEvidence) -> Float64:
    """Cycles a revolution of a ripple within three standard deviations of its estimate; one for other
    laws."""
    if trial.term.effect.cause != "cogging":
        return np.ones(1)
    variance = float(trial.fit.covariance[-1, -1])
    width = min(3.0 * float(np.sqrt(variance)), 1.0) if np.isfinite(variance) else 1.0
    out: Float64 = np.exp(float(trial.x[2]) + np.linspace(-width, width, 41))
    return out


__all__ = ["SlowMove", "rank_by_slow_moves", "sharpen_gravity"]
