"""What substitutions teach about a fixed point: Anderson's mixing, type II."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.arrays import Float64

DEPTH = 12
"""Directions remembered: lines within the width of two or three clamped resonances."""


@dataclass(frozen=True)
class Secants:
    """Pairs of moves and of what they did to the disagreement, newest last."""

    moves: tuple[Float64, ...] = ()
    changes: tuple[Float64, ...] = ()

    def plus(self, move: Float64, change: Float64) -> Secants:
        """One pair more, the oldest forgotten; a move that changed nothing tells nothing."""
        size = float(np.linalg.norm(change))
        if not np.isfinite(size) or size == 0.0:
            return self
        return Secants((*self.moves, move / size)[-DEPTH:], (*self.changes, change / size)[-DEPTH:])

    def step(self, rest: Float64) -> Float64:
        """The move that takes the disagreement ``rest`` away, as far as is known."""
        if not self.changes:
            return rest
        changes = np.column_stack(self.changes)
        share = np.linalg.lstsq(changes, rest, rcond=1e-8)[0]
        out: Float64 = rest - (np.column_stack(self.moves) + changes) @ share
        return out
