"""Rows of a large motion, and the noise of unknown strength and correlation time that they are weighed by."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from invid.numerics.arrays import Bool, Float64, Int64
from invid.numerics.compiled import compiled
from invid.rigid_motion.terms import Term, columns
from invid.signals.motion_record import Motion

PIECES = 20
"""Pieces of an experiment that are held out in turn where a recording has no validation data."""
ENOUGH = 0.5
"""Share of an axis's rows that must be far from its reversals for the others to be left out."""
TIMES, WHITE = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0), (1.0, 0.9, 0.5, 0.2, 0.05, 0.01, 0.0)
"""Correlation times in rows, and shares without correlation, to look at."""
_T = TypeVar("_T", bound=np.generic)


class Rows:
    """Rows of all motions; columns of terms are computed once and kept.

    Rows stand motion after motion, and within a motion axis after axis, so that neighbours in time are
    neighbours in a column. ``group`` numbers the pieces that are kept out together, ``gap`` (rows,) is the
    time since the row before, infinite where there is none.

    Rows within a filter's reach of a standstill or a reversal of their axis are left out where enough others
    are there: while it stands its friction may be anything, and how long it stands no row can say. With
    ``reversals`` they stay, as in the tables of the literature.
    """

    def __init__(self, motions: list[Motion], *, reversals: bool = False) -> None:
        self.motions = motions
        self.axes = motions[0].position.shape[1]
        self._cache: dict[Term, Float64] = {}
        whole: Bool = np.full(self.axes, reversals)
        for role in {m.role for m in motions}:  # what is kept out has to keep rows of its own
            far = [np.broadcast_to(m.far, (m.far.shape[0], self.axes)) for m in motions if m.role == role]
            whole |= np.concatenate(far).mean(axis=0) < ENOUGH
        self._chosen: Bool = _stacked([m.far | whole for m in motions])
        self.torque = self.stack([m.rows(m.torque) for m in motions])
        self.noise = self.stack([m.row_noise for m in motions])
        self.far = self.stack([m.far for m in motions])
        self.axis: Int64 = self._spread([np.arange(self.axes)] * len(motions))
        roles: list[Bool] = [np.full(self.axes, m.role == "validate") for m in motions]
        self.validate = self._spread(roles)
        self.has_validation = bool(self.validate.any() and not self.validate.all())
        self.train = ~self.validate if self.has_validation else np.ones(self.validate.size, dtype=bool)
        self.group, self.gap = self._places()
        self.step = float(np.median([m.row_step for m in motions]))
        self.late = np.zeros(self.axes)
        self.set_colour(Colour(np.full(self.axes, self.step), np.ones(self.axes)))

    @property
    def steady(self) -> bool:
        """Whether all are means over constant speeds."""
        return all(m.steady for m in self.motions)

    @property
    def judged(self) -> Bool:
        """Rows a result is judged on: validation rows, or all of them (each predicted unseen)."""
        return self.validate if self.has_validation else self.train

    def set_colour(self, colour: Colour) -> None:
        """Take what is in no term for correlated like this."""
        self.colour, self.independent = colour, colour.independent(self)

    @cached_property
    def every(self) -> Rows:
        """The same with every row, standing and reversing ones too."""
        every = Rows([m.whole() for m in self.motions])
        every.bend(self.late)
        return every

    def bend(self, late: Float64) -> None:
        """Second order of each axis's time offset: τ(t − δ) = τ − δ τ̇ + ½ δ² τ̈, the first being a term.

        At a hundredth of a second between samples and motion of 4 Hz it is a per cent of the torque.
        """
        parts = [m.rows(0.5 * late**2 * m.torque_bend) for m in self.motions]
        second: Float64 = self.stack(parts)
        self.torque, self.late = self.torque + second, late

    def on_axis(self, rows: list[Float64], axis: int) -> Float64:
        """What every motion has in its kept rows, (rows, M) each, in the order of this axis's rows."""
        mine: Float64 = self.stack(rows)[self.axis == axis]
        return mine

    def columns(self, term: Term) -> Float64:
        """(rows, k) of a term."""
        if term not in self._cache:
            parts = [m.rows(columns(term, m)) for m in self.motions]
            flat = [p.transpose(1, 0, 2).reshape(-1, p.shape[2]) for p in parts]
            self._cache[term] = np.concatenate(flat)[self._chosen]
        return self._cache[term]

    def matrix(self, terms: list[Term]) -> Float64:
        """(rows, Σk)."""
        none = np.zeros((self.torque.size, 0))
        return np.concatenate([none, *(self.columns(t) for t in terms)], axis=1)

    def stack(self, rows: list[NDArray[_T]]) -> NDArray[_T]:
        """What every motion has in its kept rows, (rows, M) each, in the order of these rows."""
        chosen: NDArray[_T] = _stacked(rows)[self._chosen]
        return chosen

    def _spread(self, of_axes: list[NDArray[_T]]) -> NDArray[_T]:
        counts = [int(m.keep.sum()) for m in self.motions]
        return self.stack([np.tile(one, (n, 1)) for one, n in zip(of_axes, counts, strict=True)])

    def _places(self) -> tuple[Int64, Float64]:
        groups, times, start = [], [], 0
        for number, m in enumerate(self.motions):
            at = np.flatnonzero(m.keep)
            pieces = at * PIECES // m.keep.size
            groups.append(np.tile((start + pieces)[:, None], self.axes))
            times.append(np.tile(at[:, None] * m.row_step, self.axes) + 1e12 * number)
            start += PIECES
        time = self.stack(times)
        gap = np.diff(time, prepend=-np.inf)
        new = (np.diff(self.axis, prepend=-1) != 0) | (gap < 0) | (gap > 1e11)
        return self.stack(groups), np.where(new, np.inf, gap)


def _stacked(rows: list[NDArray[_T]]) -> NDArray[_T]:
    """(Σ rows·M,) of (rows, M) of each motion: motion after motion, and within a motion axis after axis."""
    every: NDArray[_T] = np.concatenate([r.T.ravel() for r in rows])
    return every


@dataclass(frozen=True, eq=False)
class Colour:
    """How what is in no term is correlated on each axis: (1 − white)·exp(−|Δt|/time) + white."""

    time: Float64
    """(M,) [s]."""
    white: Float64
    """(M,) share of its power that is not correlated from row to row."""

    def whitened(self, rows: Rows, x: Float64) -> Float64:
        """(rows, …) without correlation (innovations of a Kalman filter)."""
        columns = x.reshape(x.shape[0], int(np.prod(x.shape[1:])))  # of no rows too
        out = np.empty_like(columns)
        for i in range(rows.axes):
            mine = rows.axis == i
            flat = np.ascontiguousarray(columns[mine])
            out[mine] = innovations(flat, np.exp(-rows.gap[mine] / self.time[i]), float(self.white[i]))[0]
        return out.reshape(x.shape)

    def independent(self, rows: Rows) -> Float64:
        """(M,) independent rows behind the rows fitted: what they tell of a constant."""
        ones = self.whitened(rows, np.ones(rows.torque.size))[rows.train]
        power = np.bincount(rows.axis[rows.train], ones**2, rows.axes)
        return np.maximum(power, 1.0)


@compiled
def innovations(x: Float64, kept: Float64, white: float) -> tuple[Float64, float]:
    """(n, k) innovations of columns over their deviation and the logarithm of the determinant, of a force of
    power one, ``kept`` (n,) of it correlated with the row before."""
    out = np.empty_like(x)
    mean = np.zeros(x.shape[1])
    spread, logarithm = 0.0, 0.0
    for row in range(x.shape[0]):
        rho = kept[row]
        spread = rho * rho * spread + (1.0 - white) * (1.0 - rho * rho)
        total = spread + white
        logarithm += np.log(total)
        gain, scale = spread / total, 1.0 / np.sqrt(total)
        for k in range(x.shape[1]):
            mean[k] *= rho
            new = x[row, k] - mean[k]
            out[row, k] = new * scale
            mean[k] += gain * new
        spread *= 1.0 - gain
    return out, logarithm


def colour_of(rows: Rows, residual: Float64) -> Colour:
    """The most likely one behind a residual of the rows fitted."""
    time, white = np.full(rows.axes, rows.step), np.ones(rows.axes)
    for i in range(rows.axes):
        mine = rows.train & (rows.axis == i)
        count, own, best = int(mine.sum()), residual[mine][:, None], np.inf
        for share in TIMES if count else ():
            kept = np.exp(-rows.gap[mine] / (share * rows.step))
            for part in WHITE:
                new, logarithm = innovations(own, kept, part)
                total = count * np.log(max(float(np.sum(new**2)), 1e-300)) + logarithm
                if total < best:
                    best, time[i], white[i] = total, share * rows.step, part
    return Colour(time, white)
