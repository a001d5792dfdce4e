"""Solve fixed points faster by Anderson's mixing, type II: what earlier substitutions teach about the
next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import qr_delete, qr_insert

from invid.numerics.arrays import Float64

DEPTH = 12
"""Directions remembered: lines within the width of two or three clamped resonances."""


@dataclass(frozen=True, eq=False)
class Secants:
    """Pairs of moves and of what they did to the disagreement, newest last, each for a change of length one.

    ``frame`` (n, k) orthonormal and ``triangle`` (k, k) are the changes' QR factors.
    """

    moves: Float64 = field(default_factory=lambda: np.zeros((0, 0)))
    changes: Float64 = field(default_factory=lambda: np.zeros((0, 0)))
    """(n, k) each."""
    frame: Float64 = field(default_factory=lambda: np.zeros((0, 0)))
    triangle: Float64 = field(default_factory=lambda: np.zeros((0, 0)))

    @classmethod
    def of(
        cls, moves: Sequence[Float64], changes: Sequence[Float64], frame: Float64 | None = None
    ) -> Secants:
        """Return a set of all of these pairs (n,), however many; ``frame`` (n, k): their changes made
        orthonormal in this order, where that is known."""
        pairs = [
            (move / size, change / size)
            for move, change in zip(moves, changes, strict=True)
            if np.isfinite(size := float(np.linalg.norm(change))) and size > 0.0
        ]
        if not pairs:
            return cls()
        columns = np.column_stack([c for _, c in pairs])
        if frame is None or frame.shape != columns.shape:
            frame = np.linalg.qr(columns)[0]
        return cls(np.column_stack([m for m, _ in pairs]), columns, frame, frame.T @ columns)

    def plus(self, move: Float64, change: Float64) -> Secants:
        """Return a set with one pair more, the oldest forgotten; a move that changed nothing is not added."""
        size = float(np.linalg.norm(change))
        if not np.isfinite(size) or size == 0.0:
            return self
        if not self.count:
            return Secants.of([move], [change])
        oldest = 1 if self.count >= DEPTH else 0
        moves = np.column_stack((self.moves[:, oldest:], move / size))
        changes = np.column_stack((self.changes[:, oldest:], change / size))
        known: Any = self.frame, self.triangle
        if oldest:
            known = qr_delete(*known, 0, which="col", check_finite=False)
        try:
            last = known[1].shape[1]
            known = qr_insert(*known, changes[:, -1], last, which="col", check_finite=False)
        except np.linalg.LinAlgError:  # it lies among the others
            known = np.linalg.qr(changes)
        frame, triangle = (np.asarray(part, dtype=np.float64) for part in known)
        return Secants(moves, changes, frame, triangle)

    @property
    def count(self) -> int:
        """Number of pairs."""
        return int(self.triangle.shape[1])

    @cached_property
    def _solver(self) -> Float64:
        """(k, k) pseudo-inverse of the triangle."""
        return np.asarray(np.linalg.pinv(self.triangle, rcond=1e-8), dtype=np.float64)

    def step(self, rest: Float64) -> Float64:
        """Return the move that takes the disagreement ``rest`` (n,) or (n, P) away, as far as is known."""
        if not self.count:
            return rest
        along = self._solver @ (self.frame.T @ rest)
        out: Float64 = rest - self.moves @ along - self.changes @ along
        return out
