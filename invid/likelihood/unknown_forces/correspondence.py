"""Two structures of one machine: which coordinate, place and parameter of one is which of the other."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass

import numpy as np

from invid.likelihood.unknown_forces.forces import Spot, Where
from invid.model.plant import Element, Plant, Structure


@dataclass(frozen=True)
class Correspondence:
    """The coordinate in ``new`` of each coordinate of ``old``; −1 where it is gone.

    Couplings and springs between loads belong to their axes, whichever masses carry them.
    """

    old: Structure
    new: Structure
    at: tuple[int, ...]

    @classmethod
    def of(cls, old: Structure, new: Structure) -> Correspondence:
        """By chain and number, by a mode's host, and the base by itself."""
        there = {name: k for k, name in enumerate(_names(new))}
        return cls(old, new, tuple(there.get(name, -1) for name in _names(old)))

    def spot(self, spot: Spot) -> Spot | None:
        """The same place in ``new``; none where it is gone, or a mass has become part of a motor."""
        if spot.where in (Where.MOTOR, Where.PAIR):
            return spot
        if spot.where is Where.MASS:
            at = self.at[spot.number]
            return Spot(Where.MASS, at) if at >= 0 and at not in self.new.motor else None
        a, b = (self.at[i] for i in self.old.links[spot.number])
        return Spot(Where.SPRING, self.new.links.index((a, b))) if (a, b) in self.new.links else None

    def plant(self, plant: Plant, added: Mapping[Element, float]) -> Plant:
        """The plant in ``new``: ``added`` values (couplings not named there are zero), all others as they
        were."""
        known = {self._name(e): float(v) for e, v in zip(self.old.elements, plant.values, strict=True)}
        same = Correspondence(self.new, self.new, tuple(range(self.new.coordinates)))
        values = [
            added[e] if e in added else known[name] if not e.joins_axes else known.get(name, 0.0)
            for e in self.new.elements
            for name in (same._name(e),)
        ]
        return Plant.of_values(self.new, np.array(values))

    def _name(self, e: Element) -> Hashable:
        if e.joins_axes:
            last = self.old.coordinates - 1
            return e.kind, *(-1 if self.old.base and i == last else self.old.axis_of(i) for i in (e.a, e.b))
        return e.kind, self.at[e.a], self.at[e.b] if e.b >= 0 else None


def _names(structure: Structure) -> list[Hashable]:
    """What each coordinate is."""
    chain = [(axis, q) for axis, n in enumerate(structure.sizes) for q in range(n)]
    modes = [("mode", chain[host]) for host in structure.modes]
    return [*chain, *modes, *(["base"] if structure.base else [])]
