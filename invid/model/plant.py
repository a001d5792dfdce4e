"""Which parameters a plant has, and the plant with its numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from invid.model.matrices import Condensed, Element, Kind, Matrices, Terms
from invid.numerics.arrays import Bool, Float64


@dataclass(frozen=True)
class Structure:
    """Which parameters a plant has: chains of ``sizes`` masses, one more mass on a spring at each of the
    coordinates ``modes``, and a ``base`` under all loads on a spring to ground.

    Coordinates stand chain after chain, then the masses of ``modes``, then the base. All loads are coupled
    through inertia and through springs; the base is coupled to them through inertia.
    """

    sizes: tuple[int, ...]
    modes: tuple[int, ...] = ()
    base: bool = False

    @property
    def motors(self) -> int:
        """M."""
        return len(self.sizes)

    @property
    def coordinates(self) -> int:
        """n."""
        return sum(self.sizes) + len(self.modes) + self.base

    @cached_property
    def motor(self) -> tuple[int, ...]:
        """Coordinate of each motor."""
        return tuple(int(i) for i in np.cumsum((0, *self.sizes[:-1])))

    @cached_property
    def load(self) -> tuple[int, ...]:
        """Coordinate of each chain's final mass."""
        return tuple(int(i) - 1 for i in np.cumsum(self.sizes))

    @cached_property
    def inner(self) -> tuple[int, ...]:
        """Coordinates that are no motor."""
        return tuple(i for i in range(self.coordinates) if i not in self.motor)

    @cached_property
    def tip(self) -> tuple[int, ...]:
        """Coordinate of the outermost mass of each chain: its mode's, else its load."""
        tips = list(self.load)
        for k, host in enumerate(self.modes):
            if host in self.load:
                tips[self.load.index(host)] = sum(self.sizes) + k
        return tuple(tips)

    def axis_of(self, coordinate: int) -> int:
        """The chain to which a mass belongs, that of a mode included; the first for the base."""
        chain = sum(self.sizes)
        if coordinate - chain == len(self.modes):
            return 0
        host = self.modes[coordinate - chain] if coordinate >= chain else coordinate
        return max(i for i, first in enumerate(self.motor) if first <= host)

    @cached_property
    def links(self) -> tuple[tuple[int, int], ...]:
        """Coordinates that each spring joins, chain after chain, then those of ``modes``."""
        chain = [
            (first + q, first + q + 1)
            for first, n in zip(self.motor, self.sizes, strict=True)
            for q in range(n - 1)
        ]
        return (*chain, *((host, sum(self.sizes) + k) for k, host in enumerate(self.modes)))

    @cached_property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of chains, i < j."""
        return tuple(combinations(range(self.motors), 2))

    @cached_property
    def elements(self) -> tuple[Element, ...]:
        """The parameters in the order of ``Plant.x``."""
        grounded = [(self.coordinates - 1, -1)] if self.base else []
        stands_on = [(load, self.coordinates - 1) for load in self.load] if self.base else []
        coupled = [*((self.load[i], self.load[j]) for i, j in self.pairs), *stands_on]
        return (
            *(Element(Kind.MASS, i) for i in range(self.coordinates)),
            *(Element(Kind.SPRING, a, b) for a, b in (*self.links, *grounded)),
            *(Element(Kind.DAMPER, a, b) for a, b in (*self.links, *grounded)),
            *(Element(Kind.COUPLING, a, b) for a, b in coupled),
            *(Element(Kind.LOAD_SPRING, self.tip[i], self.tip[j]) for i, j in self.pairs),
        )

    def index(self, kind: Kind) -> slice:
        """Where the parameters of a kind stand."""
        at = [k for k, e in enumerate(self.elements) if e.kind is kind]
        return slice(at[0], at[-1] + 1) if at else slice(0, 0)

    @cached_property
    def logarithmic(self) -> Bool:
        """(p,) which parameters move as logarithms."""
        return np.array([e.kind.logarithmic for e in self.elements], dtype=bool)

    @cached_property
    def prior(self) -> Float64:
        """(p,) standard deviations of the weak prior."""
        return np.array([e.kind.prior for e in self.elements])

    @cached_property
    def terms(self) -> Terms:
        """The rank-one terms of all parameters."""
        return Terms.of(self.coordinates, self.elements)


@dataclass(frozen=True, eq=False)
class Plant:
    """A structure with its numbers: ``x`` (p,) as they move, ``unit`` (p,) of those that move linearly."""

    structure: Structure
    x: Float64
    unit: Float64

    @classmethod
    def of_values(cls, structure: Structure, values: Float64) -> Plant:
        """The plant with physical ``values`` (p,) [kg·m², N·m/rad, N·m·s/rad or of linear axes].

        Couplings move in units of their loads' masses, load springs in units of the springs' geometric
        mean; a damper of zero moves from a thousandth of what its spring and masses make aperiodic.
        """
        unit, log = np.ones(len(values)), structure.logarithmic
        mass = values[structure.index(Kind.MASS)]
        springs = values[structure.index(Kind.SPRING)]
        dampers = structure.index(Kind.DAMPER)
        joined = structure.elements[structure.index(Kind.SPRING)]
        eased = [1 / mass[e.a] + (1 / mass[e.b] if e.b >= 0 else 0.0) for e in joined]
        values = values.copy()
        values[dampers] = np.maximum(values[dampers], 1e-3 * np.sqrt(springs / np.array(eased).reshape(-1)))
        for p, e in enumerate(structure.elements):
            if e.kind is Kind.COUPLING:
                unit[p] = np.sqrt(mass[e.a] * mass[e.b])
            elif e.kind is Kind.LOAD_SPRING:
                unit[p] = np.exp(np.log(springs).mean()) if springs.size else float(mass.mean())
        x = np.where(log, np.log(np.where(log, values, 1.0)), values / unit)
        return cls(structure, x, unit)

    @cached_property
    def values(self) -> Float64:
        """(p,) physical values."""
        log = self.structure.logarithmic
        out: Float64 = np.where(log, np.exp(np.where(log, self.x, 0.0)), self.x * self.unit)
        return out

    @property
    def slope(self) -> Float64:
        """(p,) physical value for a step of one in ``x``."""
        out: Float64 = np.where(self.structure.logarithmic, self.values, self.unit)
        return out

    def moved(self, x: Float64) -> Plant:
        """The plant with other numbers (p,)."""
        return replace(self, x=x)

    def of_kind(self, kind: Kind) -> Float64:
        """Physical values of one kind."""
        return self.values[self.structure.index(kind)]

    @cached_property
    def matrices(self) -> Matrices:
        """Stiffness, damping and inertia."""
        return self.structure.terms.matrices(self.values)

    def is_admissible(self) -> bool:
        """Return whether all is finite and the inertia positive definite."""
        if not np.isfinite(self.values).all():
            return False
        inertia = self.matrices.mass
        scale = 1.0 / np.sqrt(np.maximum(np.diag(inertia), 1e-300))
        return bool(np.linalg.eigvalsh(inertia * scale[:, None] * scale)[0] > 1e-3)

    def condense(self, omega: Float64) -> Condensed:
        """The plant as the motors see it on lines ``omega`` (F,) [rad/s]."""
        return Condensed.of(self.matrices.dynamic_stiffness(1j * omega), self.structure.motor)


__all__ = ["Condensed", "Element", "Kind", "Matrices", "Plant", "Structure", "Terms"]
