"""Weighted least squares over all experiments, with the serial correlation of the residual respected."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from invid.numerics.arrays import Bool, Float64
from invid.rigid_motion.regressors import Regressor, columns
from invid.signals.motion_record import Motion

BLOCKS = 20
"""Pieces of an experiment that are held out in turn where a recording has no validation data."""
_T = TypeVar("_T", bound=np.generic)
ENOUGH = 0.5
"""Share of an axis's rows that must be far from its reversals for the others to be left out."""


def stacked(rows: list[NDArray[_T]]) -> NDArray[_T]:
    """(Σ rows·M,) of (rows, M) of each motion: motion after motion, and within a motion axis after axis."""
    every: NDArray[_T] = np.concatenate([r.T.ravel() for r in rows])
    return every


class Design:
    """Rows of all motions; columns of terms are computed once and kept.

    Rows stand motion after motion, and within a motion axis after axis, so that neighbours in time are
    neighbours in a column. ``group`` numbers the pieces that are kept out together.

    Rows within a filter's reach of a standstill or a reversal of their axis are left out where enough others
    are there: while it stands its friction may be anything, and how long it stands no row can say. With
    ``reversals`` they stay, as in the tables of the literature.
    """

    def __init__(self, motions: list[Motion], *, reversals: bool = False) -> None:
        self.motions = motions
        self.axes = motions[0].position.shape[1]
        self._cache: dict[Regressor, Float64] = {}
        whole = np.full(self.axes, reversals)
        for role in {m.role for m in motions}:  # what is kept out has to keep rows of its own
            far = [np.broadcast_to(m.far, (m.far.shape[0], self.axes)) for m in motions if m.role == role]
            whole |= np.concatenate(far).mean(axis=0) < ENOUGH
        self._chosen: Bool = stacked([m.far | whole for m in motions])
        self.torque = self._stack([m.rows(m.torque) for m in motions])
        self.noise = self._stack([m.row_noise for m in motions])
        shape = [(m.keep.sum(), m) for m in motions]
        self.axis = np.concatenate([np.repeat(np.arange(self.axes), n) for n, _ in shape])[self._chosen]
        self.far = self._stack([m.far for m in motions])
        self.group = self._groups()[self._chosen]
        validate = np.concatenate([np.full(n * self.axes, m.role == "validate") for n, m in shape])
        validate = validate[self._chosen]
        self.validate = validate
        self.has_validation = bool(validate.any() and not validate.all())
        self.train = ~validate if self.has_validation else np.ones(validate.size, dtype=bool)
        scale = [self.torque[self.axis == i].std() or 1.0 for i in range(self.axes)]
        self.weight = 1.0 / np.array(scale)[self.axis]

    def bend(self, late: Float64) -> None:
        """Second order of each axis's time offset: τ(t − δ) = τ − δ τ̇ + ½ δ² τ̈, the first being a term.

        At a hundredth of a second between samples and motion of 4 Hz it is a per cent of the torque.
        """
        parts = [m.rows(0.5 * late**2 * m.torque_bend) for m in self.motions]
        second: Float64 = self._stack(parts)
        self.torque = self.torque + second

    def _stack(self, rows: list[NDArray[_T]]) -> NDArray[_T]:
        chosen: NDArray[_T] = stacked(rows)[self._chosen]
        return chosen

    def on_axis(self, rows: list[Float64], axis: int) -> Float64:
        """What every motion has in its kept rows, (rows, M) each, in the order of this axis's rows."""
        mine: Float64 = self._stack(rows)[self.axis == axis]
        return mine

    def _groups(self) -> Float64:
        groups: list[Float64] = []
        start = 0
        for m in self.motions:
            n = int(m.keep.sum())
            if m.steady:
                pieces = np.zeros(n)
            else:
                pieces = np.floor(np.arange(n) * BLOCKS / max(n, 1))
            groups.append(np.tile(start + pieces, self.axes))
            start += int(pieces.max(initial=0)) + 1
        return np.concatenate(groups)

    def columns(self, term: Regressor) -> Float64:
        """(rows, k) of a term."""
        if term not in self._cache:
            parts = []
            for m in self.motions:
                rows = m.rows(columns(term, m))
                parts.append(rows.transpose(1, 0, 2).reshape(-1, rows.shape[2]))
            self._cache[term] = np.concatenate(parts)[self._chosen]
        return self._cache[term]

    def matrix(self, terms: list[Regressor]) -> Float64:
        """(rows, Σk)."""
        if not terms:
            return np.zeros((self.torque.size, 0))
        return np.concatenate([self.columns(t) for t in terms], axis=1)

    def reweigh(self, residual: Float64) -> None:
        """Weight each axis by the rms of its residual on the training rows."""
        for i in range(self.axes):
            mine = self.axis == i
            scatter = np.mean(residual[mine & self.train] ** 2) if (mine & self.train).any() else 0.0
            self.weight[mine] = 1.0 / max(float(np.sqrt(scatter)), 1e-300)


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit of one set of terms.

    ``held_out`` is the residual of every row as a fit that has not seen it predicts it: a validation row by
    the fit to all training rows, a training row by the fit to the pieces beside its own.
    """

    terms: list[Regressor]
    value: Float64
    covariance: Float64
    residual: Float64
    held_out: Float64
    cost: float
    """Weighted sum of squares of the training rows over their count."""
    effective: float
    """Independent rows behind the training rows, from the residual's serial correlation."""
    condition: float

    def of(self, term: Regressor) -> tuple[Float64, Float64]:
        """Coefficients of one term and their standard deviations."""
        start = 0
        for t in self.terms:
            if t is term:
                part = slice(start, start + len(t.names))
                return self.value[part], np.sqrt(np.maximum(np.diag(self.covariance)[part], 0.0))
            start += len(t.names)
        raise KeyError(term.cause)


def noise_of(design: Design, result: Fit) -> Float64:
    """(rows,) variance that white noise of torque and position alone leaves in each row."""
    variance = design.noise.copy()
    for term in result.terms:
        if term.cause == "inertia":
            mass = float(result.of(term)[0][0])
            own = design.axis == term.axis
            variance[own] += mass**2 * float(design.motions[0].band.accelerating()[term.axis])
    return variance


def correlation_length(residual: Float64, group: Float64, axis: Float64) -> float:
    """1 + 2 Σ ρ_k of the residual within its pieces, summed until ρ falls into its own noise."""
    lags: dict[int, list[float]] = {}
    power = 0.0
    count = 0
    for i in np.unique(axis):
        for g in np.unique(group[axis == i]):
            piece = residual[(group == g) & (axis == i)]
            power += float(piece @ piece)
            count += piece.size
            for k in range(1, min(piece.size // 2, 60)):
                lags.setdefault(k, [0.0, 0.0])
                lags[k][0] += float(piece[k:] @ piece[:-k])
                lags[k][1] += piece.size - k
    if power <= 0 or not lags:
        return 1.0
    total = 1.0
    for k in sorted(lags):
        rho = lags[k][0] / max(lags[k][1], 1.0) / (power / count)
        if rho < 2.0 / np.sqrt(count):
            break
        total += 2.0 * rho
    return max(total, 1.0)


def _scaled_lstsq(matrix: Float64, torque: Float64) -> Float64:
    scale = np.sqrt((matrix**2).sum(axis=0))
    scale[scale == 0] = 1.0
    solution: Float64 = np.linalg.lstsq(matrix / scale, torque, rcond=1e-10)[0] / scale
    # A column of nothing (a coefficient held at zero) has rounding for a solution.
    return np.where(np.any(matrix, axis=0), solution, 0.0)


def fit_terms(design: Design, terms: list[Regressor], *, correlation: float | None = None) -> Fit:
    """Least squares on the training rows, and on all but each piece of them."""
    matrix, torque, weight = design.matrix(terms), design.torque, design.weight
    train = design.train
    wm, wt = matrix * weight[:, None], torque * weight
    value = _scaled_lstsq(wm[train], wt[train])
    residual = torque - matrix @ value
    held_out = residual.copy()
    for fold in _folds(design.group[train]):
        g = np.zeros(torque.size, dtype=bool)
        g[train] = fold
        seen = train & ~g
        held_out[g] = torque[g] - matrix[g] @ _scaled_lstsq(wm[seen], wt[seen])
    weighted = residual * weight
    length = correlation or correlation_length(weighted[train], design.group[train], design.axis[train])
    count, free = int(train.sum()), matrix.shape[1]
    cost = float(np.mean(weighted[train] ** 2))
    scale = np.sqrt((wm[train] ** 2).sum(axis=0))
    scale[scale == 0] = 1.0
    gram = (wm[train] / scale).T @ (wm[train] / scale)
    inverse = np.linalg.pinv(gram, rcond=1e-12) / np.outer(scale, scale)
    spread = cost * count / max(count - free * length, 1.0)
    condition = float(np.linalg.cond(gram)) if free else 1.0
    return Fit(terms, value, inverse * spread * length, residual, held_out, cost, count / length, condition)


def _folds(group: Float64) -> list[np.typing.NDArray[np.bool_]]:
    numbers = np.unique(group)
    # At most forty folds: neighbours go out together, so that a fold is longer than any correlation.
    sets = np.array_split(numbers, min(40, numbers.size)) if numbers.size > 2 else [numbers]
    return [np.isin(group, s) for s in sets]
