"""Where an effect may sit, and which coordinates its force acts on."""

from __future__ import annotations

from dataclasses import dataclass

from invid.model.plant import Structure

Pattern = tuple[tuple[int, float], ...]
"""Coordinates with their signs: ((a, 1),) on one mass, ((a, 1), (b, −1)) between two."""


@dataclass(frozen=True)
class Place:
    """Where an effect may sit. ``number`` counts masses and springs from 1; ``axis``, ``other`` from 0."""

    kind: str  # "mass", "spring", "axis", "pair", "base"
    axis: int
    number: int = 0
    other: int = -1

    @property
    def element(self) -> str | None:
        """As the contract writes it."""
        return f"{self.kind} {self.number}" if self.kind in ("mass", "spring") else None

    def pattern(self, structure: Structure) -> Pattern:
        """The coordinates a force of the effect acts on."""
        first = structure.motor[self.axis]
        if self.kind == "mass":
            return ((first + self.number - 1, 1.0),)
        if self.kind == "spring":
            return ((first + self.number - 1, 1.0), (first + self.number, -1.0))
        if self.kind == "pair":
            return ((structure.load[self.axis], 1.0), (structure.load[self.other], -1.0))
        if self.kind == "base":  # all loads alike, by a unit vector
            weight = structure.motors**-0.5
            return tuple((at, weight) for at in structure.load)
        return ((first, 1.0),)


def mass_places(structure: Structure) -> list[Place]:
    """Every mass of every axis."""
    return [Place("mass", i, q + 1) for i, n in enumerate(structure.sizes) for q in range(n)]


def motor_places(structure: Structure) -> list[Place]:
    """The motors."""
    return [Place("mass", i, 1) for i in range(structure.motors)]


def end_places(structure: Structure) -> list[Place]:
    """The final masses."""
    return [Place("mass", i, n) for i, n in enumerate(structure.sizes)]


def spring_places(structure: Structure) -> list[Place]:
    """Every spring of every axis."""
    return [Place("spring", i, s + 1) for i, n in enumerate(structure.sizes) for s in range(n - 1)]


def axis_places(structure: Structure) -> list[Place]:
    """The axes as such."""
    return [Place("axis", i) for i in range(structure.motors)]


def pair_places(structure: Structure) -> list[Place]:
    """Pairs of axes."""
    return [Place("pair", i, other=j) for i, j in structure.pairs]
