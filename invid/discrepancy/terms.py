"""Effects at their places, and what they contribute to the missing torque together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.arrays import Complex128, Float64
from invid.discrepancy.inner import Forces, settled
from invid.effects.base import Effect
from invid.effects.place import Place
from invid.effects.view import View

PASSES = 12
"""Most steps of inner motion and the forces that depend on it; weak effects agree after two or three."""


@dataclass(frozen=True)
class Term:
    """An effect at a place."""

    effect: Effect
    place: Place

    @property
    def size(self) -> int:
        """Length of its parameter vector."""
        return len(self.effect.coefficients) + len(self.effect.shapes)

    @property
    def inner(self) -> bool:
        """Whether it depends on inner motion, which forces change."""
        return self.place.kind in ("spring", "pair") or (self.place.kind == "mass" and self.place.number > 1)


@dataclass(frozen=True, eq=False)
class Candidate:
    """Effects with their parameter vectors."""

    terms: tuple[Term, ...] = ()
    x: tuple[Float64, ...] = ()

    def plus(self, term: Term, x: Float64) -> Candidate:
        """One effect more."""
        return Candidate((*self.terms, term), (*self.x, np.asarray(x, dtype=float)))


def contributions(
    view: View, candidate: Candidate, *, passes: int = PASSES, early: bool = True
) -> Complex128:
    """(F, M) of all effects, inner motion brought into agreement with the forces.

    ``early``: stop as soon as it is; otherwise a fixed number of steps along what is known, for differences.
    """
    if not candidate.terms:
        return np.zeros_like(view.acting)
    forces = forces_of(view, candidate)
    if not any(t.inner for t in candidate.terms):
        return forces()[0]
    return settled(view, forces, passes, early=early)


def forces_of(view: View, candidate: Candidate) -> Forces:
    """What the effects contribute at the view's present inner motion, and the inner motion that follows."""
    inner = any(t.inner for t in candidate.terms)
    patterns = tuple(
        t.place.pattern(view.structure)
        for t in candidate.terms
        if t.place.kind != "axis" and t.effect.along_pattern
    )

    def forces() -> tuple[Complex128, Complex128]:
        total: Complex128 = np.zeros_like(view.acting)
        back: Complex128 = np.zeros_like(view.base)
        for term, x in zip(candidate.terms, candidate.x, strict=True):
            own, yields = term.effect.contribution(view, term.place, x.tolist())
            total = total + own
            if yields is not None:
                back = back + yields
        rest = view.left(total) if inner and patterns else None
        if rest is not None:
            back = back + view.correction(patterns, rest)
        return total, back

    return forces
