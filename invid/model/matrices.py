"""Stiffness, damping and inertia as sums of rank-one terms, and what motors see of them.

    D(s) = K + sC + s²M = Σ_p v_p Σ_t c_t s^k_t u_t u_tᵀ

Every parameter p adds terms u uᵀ of stiffness (k = 0), damping (1) or inertia (2), so that no derivative
needs code of its own: a change of D by u uᵀ changes the dynamic stiffness at the motors by V u uᵀ Vᵀ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from invid.numerics.arrays import Complex128, Float64, Int64


class Kind(Enum):
    """Kinds of parameters, each with the standard deviation of its weak prior, in the units in which it
    moves.

    Masses, springs and dampers move as logarithms, couplings and load springs in units of their own
    (``Plant.unit``). The priors keep what the data do not show near its start (empirical: a factor of twenty
    for masses and springs, of five for dampers).
    """

    MASS = ("mass", 3.0)
    SPRING = ("spring", 3.0)
    DAMPER = ("damper", 1.5)
    COUPLING = ("coupling", 3.0)
    LOAD_SPRING = ("load_spring", 3.0)

    def __init__(self, word: str, prior: float) -> None:
        self.word, self.prior = word, prior

    @property
    def logarithmic(self) -> bool:
        """Whether it moves as a logarithm."""
        return self in (Kind.MASS, Kind.SPRING, Kind.DAMPER)


@dataclass(frozen=True)
class Element:
    """One parameter: its kind, and the coordinates that it joins (``b`` = −1: none)."""

    kind: Kind
    a: int
    b: int = -1

    @property
    def joins_axes(self) -> bool:
        """Whether it is between two axes, or an axis and the base."""
        return self.kind in (Kind.COUPLING, Kind.LOAD_SPRING)


Part = tuple[Element, float]
"""An element with its value."""


def mass(value: float, at: int) -> Part:
    """A mass at a coordinate."""
    return Element(Kind.MASS, at), value


def spring(value: float, a: int, b: int = -1) -> Part:
    """A spring between two coordinates, or one and ground."""
    return Element(Kind.SPRING, a, b), value


def damper(value: float, a: int, b: int = -1) -> Part:
    """A damper between two coordinates, or one and ground."""
    return Element(Kind.DAMPER, a, b), value


def coupling(value: float, a: int, b: int) -> Part:
    """Inertia that each of two coordinates feels of the other's acceleration."""
    return Element(Kind.COUPLING, a, b), value


@dataclass(frozen=True, eq=False)
class Terms:
    """Rank-one terms: vectors (n, T), powers of s, signs and the parameters they belong to, each (T,)."""

    vectors: Float64
    power: Int64
    sign: Float64
    owner: Int64

    @classmethod
    def of(cls, coordinates: int, elements: Sequence[Element]) -> Terms:
        """The terms of elements between so many coordinates."""
        unit = np.eye(coordinates)
        vectors, power, sign, owner = [np.zeros(coordinates)][:0], [], [], []
        for p, e in enumerate(elements):
            apart = unit[e.a] - unit[e.b] if e.b >= 0 else unit[e.a]
            order = {Kind.MASS: 2, Kind.COUPLING: 2, Kind.DAMPER: 1}.get(e.kind, 0)
            if e.kind is Kind.COUPLING:  # e_a e_bᵀ + e_b e_aᵀ
                parts = [(unit[e.a] + unit[e.b], 0.5), (apart, -0.5)]
            else:
                parts = [(apart, 1.0)]
            for vector, factor in parts:
                vectors.append(vector)
                power.append(order)
                sign.append(factor)
                owner.append(p)
        return cls(np.array(vectors).T, np.array(power), np.array(sign), np.array(owner))

    @cached_property
    def _first(self) -> Int64:
        return np.flatnonzero(np.diff(self.owner, prepend=-1))

    def by_parameter(self, values: NDArray[Any]) -> NDArray[Any]:
        """(…, p) sums over the terms (…, T) of each parameter."""
        return np.add.reduceat(values, self._first, axis=-1)

    def factors(self, omega: Float64, slope: Float64) -> Complex128:
        """(F, T) what each term is multiplied by for a step of its parameter, of slope (p,) in physical
        units."""
        powers = (1j * omega)[:, None] ** self.power
        return np.asarray(powers * (self.sign * slope[self.owner]), dtype=np.complex128)

    def matrices(self, values: Float64) -> Matrices:
        """The sums for parameters of these values (p,)."""
        weight, u = self.sign * values[self.owner], self.vectors
        return Matrices(*((u * np.where(self.power == k, weight, 0.0)) @ u.T for k in range(3)))


class Matrices(NamedTuple):
    """Stiffness, damping and inertia of n coordinates, (n, n) each."""

    stiffness: Float64
    damping: Float64
    mass: Float64

    @classmethod
    def of(cls, coordinates: int, parts: Sequence[Part]) -> Matrices:
        """Those of elements with their values."""
        values = np.array([value for _, value in parts])
        return Terms.of(coordinates, [element for element, _ in parts]).matrices(values)

    def plus(self, parts: Sequence[Part]) -> Matrices:
        """With more elements between the same coordinates."""
        if not parts:
            return self
        more = Matrices.of(self.mass.shape[0], parts)
        return Matrices(*(mine + theirs for mine, theirs in zip(self, more, strict=True)))

    def dynamic_stiffness(self, s: NDArray[Any]) -> Complex128:
        """(F, n, n) D at complex frequencies s (F,) [1/s]."""
        at = np.asarray(s)[:, None, None]
        return np.asarray(self.stiffness + at * self.damping + at**2 * self.mass, dtype=np.complex128)

    @property
    def natural(self) -> Float64:
        """(n,) undamped natural frequencies [rad/s], ascending; 0 for rigid modes."""
        return natural_frequencies(self.mass, self.stiffness)

    @property
    def rates(self) -> Float64:
        """(2n, 2n) A of ẋ = A x for x = [q; q̇]."""
        n = self.mass.shape[0]
        moved = -np.linalg.solve(self.mass, np.hstack([self.stiffness, self.damping]))
        return np.vstack([np.eye(n, 2 * n, n), moved])

    def among(self, kept: Sequence[int]) -> Matrices:
        """With all other coordinates held."""
        at = np.ix_(kept, kept)
        return Matrices(*(m[at] for m in self))


@dataclass(frozen=True, eq=False)
class Condensed:
    """A plant as its motors see it on F lines.

    ``receptance`` (F, n, n): X, inverse of D over the inner coordinates, zero elsewhere. ``motion`` (F, M,
    n): V = [I, −D_mi X], what a force at any coordinate asks of the motors, and (transposed) how every
    coordinate moves with them. ``stiffness`` (F, M, M): Z = V D_·m.
    """

    receptance: Complex128
    motion: Complex128
    stiffness: Complex128

    @classmethod
    def of(cls, dynamic: Complex128, motors: Sequence[int]) -> Condensed:
        """From D (F, n, n), all coordinates but those of the motors free."""
        motor = np.array(motors)
        inner = np.setdiff1d(np.arange(dynamic.shape[1]), motor)
        receptance = np.zeros(dynamic.shape, dtype=complex)
        if inner.size:
            block = np.ix_(np.arange(dynamic.shape[0]), inner, inner)
            receptance[block] = np.linalg.inv(dynamic[block])
        motion = -dynamic[:, motor] @ receptance
        motion[:, :, motor] = np.eye(motor.size)
        return cls(receptance, motion, motion @ dynamic[:, :, motor])

    def jumps(self, omega: Float64) -> Complex128:
        """(F, M, 2n) what the ends of a record ask of the motors: V, then jωV."""
        return np.concatenate((self.motion, 1j * omega[:, None, None] * self.motion), axis=2)


def natural_frequencies(mass: Float64, stiffness: Float64) -> Float64:
    """(n,) undamped natural frequencies of (n, n) matrices [rad/s], ascending; 0 for rigid modes."""
    values = scipy.linalg.eigh(stiffness, mass, eigvals_only=True)
    natural: Float64 = np.sqrt(np.maximum(values, 0.0))
    return natural
