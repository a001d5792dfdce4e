"""Solve fixed points faster by Anderson's mixing, type II: what earlier substitutions teach about the
next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from invid.numerics.arrays import Float64

DEPTH = 12
"""Directions remembered: lines within the width of two or three clamped resonances."""


@dataclass(frozen=True)
class Secants:
    """Pairs of moves and of what they did to the disagreement, newest last."""

    moves: tuple[Float64, ...] = ()
    changes: tuple[Float64, ...] = ()

    @classmethod
    def of(cls, moves: Sequence[Float64], changes: Sequence[Float64]) -> Secants:
        """Return a set of all of these pairs, however many."""
        pairs = [
            (move / size, change / size)
            for move, change in zip(moves, changes, strict=True)
            if np.isfinite(size := float(np.linalg.norm(change))) and size > 0.0
        ]
        return cls(tuple(m for m, _ in pairs), tuple(c for _, c in pairs))

    def plus(self, move: Float64, change: Float64) -> Secants:
        """Return a set with one pair more, the oldest forgotten; a move that changed nothing is not added."""
        size = float(np.linalg.norm(change))
        if not np.isfinite(size) or size == 0.0:
            return self
        depth = max(DEPTH, len(self.moves))
        return Secants((*self.moves, move / size)[-depth:], (*self.changes, change / size)[-depth:])

    @cached_property
    def _inverse(self) -> Float64:
        """(k, n) pseudo-inverse of the changes."""
        frame, triangle = np.linalg.qr(np.column_stack(self.changes))
        out: Float64 = np.linalg.pinv(triangle, rcond=1e-8) @ frame.T
        return out

    @cached_property
    def _both(self) -> Float64:
        """(n, k) moves and changes together."""
        return np.column_stack(self.moves) + np.column_stack(self.changes)

    def step(self, rest: Float64) -> Float64:
        """Return the move that takes the disagreement ``rest`` away, as far as is known."""
        if not self.changes:
            return rest
        out: Float64 = rest - self._both @ (self._inverse @ rest)
        return out
