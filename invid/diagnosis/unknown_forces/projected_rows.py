"""Whitened rows of a fit from which everything that the fit moves is projected out."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.forces import Spot
from invid.likelihood.unknown_forces.motions import PlacedLaw, vector_of
from invid.likelihood.unknown_forces.shapes import joint_rows
from invid.likelihood.unknown_forces.slope import whitened_rows
from invid.likelihood.unknown_forces.value import StackWork, along
from invid.numerics.arrays import Complex128, Float64


def law_rows(now: FittedHypothesis, placed: PlacedLaw) -> list[Float64]:
    """(rows, k) whitened rows of a law in each stack, one column a coefficient of one: of a force at its
    place, of what its motor's reading errs by, or of the torque that it scales."""
    lines = now.bench.law_lines(placed, now.motions, quick=True)
    vector = vector_of(now.hypothesis.structure, placed.spot)[:, None]
    out = []
    for work, wave in zip(now.fit.value.work, lines, strict=True):
        if placed.law.scales:
            torque = -now.numbers.timing.acting(work.stack)[:, :, placed.spot.number]
            rows = torque[..., None, None] * np.eye(work.shape[2])[placed.spot.number][:, None]
        elif placed.law.reads:
            rows = _read(work, wave, placed.spot.number)
        else:
            rows = wave[:, :, None] * along(work.condensed.motion, vector)
        out.append(whitened_rows(work, rows).reshape(-1, wave.shape[2]))
    return out


def scale_rows(now: FittedHypothesis, spot: Spot) -> list[Float64]:
    """(rows, 1) whitened rows in each stack of a motor's reading that is taken for another scale."""
    motor = spot.number
    return [
        whitened_rows(work, _read(work, work.stack.position[..., motor, None], motor)).reshape(-1, 1)
        for work in now.fit.value.work
    ]


def _read(work: StackWork, wave: Complex128, motor: int) -> Complex128:
    """(R, F, M, k) torque missing by waves (R, F, k) by which a motor stands beyond its reading."""
    return wave[:, :, None] * work.condensed.stiffness[:, :, motor, None]


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows at a fit, those of the weak prior of its numbers at the end."""

    now: FittedHypothesis

    @cached_property
    def moved(self) -> Float64:
        """(rows, p + J') columns of all that the fit moves."""
        rows = np.concatenate([joint_rows(self.now, k) for k in range(len(self.now.fit.value.work))])
        tail = np.zeros((self.now.numbers.x.size, rows.shape[1]))
        np.fill_diagonal(tail, 1.0 / self.now.fit.problem.spread)
        return np.concatenate((rows, tail))

    @cached_property
    def basis(self) -> Float64:
        """(rows, p + J') the same, orthonormal."""
        return _orthonormal(self.moved)

    def project(self, columns: Float64) -> Float64:
        """(rows, k) what nothing else in the fit explains of columns (rows without the prior's, k)."""
        whole = np.concatenate((columns, np.zeros((self.now.numbers.x.size, *columns.shape[1:]))))
        out: Float64 = whole - self.basis @ (self.basis.T @ whole)
        return out

    @cached_property
    def missing(self) -> Float64:
        """(rows,) missing torque."""
        value = self.now.fit.value
        left = [(w.missing + w.laws @ value.coefficients).ravel() for w in value.work]
        return self.project(np.concatenate(left))

    def of_law(self, placed: PlacedLaw) -> Float64:
        """(rows, k) of a law, one a coefficient."""
        return self.project(self.felt_of(placed))

    def felt_of(self, placed: PlacedLaw) -> Float64:
        """(rows, k) of a law with nothing projected out."""
        return np.concatenate(law_rows(self.now, placed))

    def of_force(self, lines: list[Complex128], vector: Float64) -> Float64:
        """(rows, k) of forces with lines (R, F, k) of each stack along ``vector`` (n,)."""
        return self.project(self.felt(lines, vector))

    def felt(self, lines: list[Complex128], vector: Float64) -> Float64:
        """(rows, k) the same with nothing projected out."""
        out = []
        for work, wave in zip(self.now.fit.value.work, lines, strict=True):
            reach = along(work.condensed.motion, vector[:, None])
            out.append(whitened_rows(work, wave[:, :, None] * reach).reshape(-1, wave.shape[2]))
        return np.concatenate(out)

    def of_number(self, number: int) -> Float64:
        """(rows,) of one of the fit's own numbers, its prior taken away: what all others leave of it."""
        column = self.moved[:, number].copy()
        column[column.size - self.now.numbers.x.size + number] = 0.0
        rest = _orthonormal(np.delete(self.moved, number, axis=1))
        out: Float64 = column - rest @ (rest.T @ column)
        return out

    @property
    def price(self) -> float:
        """Fall of −2 ln L that each further number must bring (Schwarz)."""
        return float(np.log(self.missing.size))


def _orthonormal(columns: Float64) -> Float64:
    length = np.linalg.norm(columns, axis=0)
    seen = length > 0.0
    return np.asarray(np.linalg.qr(columns[:, seen] / length[seen])[0], dtype=np.float64)
