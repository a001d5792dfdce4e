"""Unknown forces: where something may act that no law names, and how strong it is there.

At every place p (a unit vector or a difference of two, b_p) acts a force of zero mean and power q_p·g(ω), g
one of ``colours``. In the covariance of the motors' missing torque it adds q_p g H_p H_pᴴ with H_p = V b_p:
noise of the right place and colour. What is not modelled biases no plant then, and speaks for no wrong cause.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import numpy as np

from invid.model.plant import Structure
from invid.numerics.arrays import Complex128, Float64

CORNER = 0.4
"""Corner of the coloured force over the highest excited line: friction and play fall off with frequency, a
torque that ripples does not (empirical: 5 Hz for a band of 12)."""
LEAST, FIRST = 1e-9, 1e-3
"""Least and first strength over the torque noise of a line: a strength of zero could not grow again."""
COLOURS = 2
"""Kinds of unknown force at each place: one that falls off with frequency, one that does not."""


class Where(Enum):
    """Kinds of places."""

    MOTOR = "motor"
    MASS = "mass"
    SPRING = "spring"
    PAIR = "pair"


@dataclass(frozen=True)
class Spot:
    """A place of an unknown force: a motor or inner mass (coordinate), a spring (its number), or two
    loads."""

    where: Where
    number: int
    other: int = -1


@dataclass(frozen=True, eq=False)
class Spots:
    """All places of a structure, with their vectors (n, P)."""

    spots: tuple[Spot, ...]
    vectors: Float64

    @classmethod
    def of(cls, structure: Structure) -> Spots:
        """Every motor, inner mass, spring and pair of loads."""
        unit = np.eye(structure.coordinates)
        found = [(Spot(Where.MOTOR, i), unit[a]) for i, a in enumerate(structure.motor)]
        found += [(Spot(Where.MASS, a), unit[a]) for a in structure.inner]
        found += [(Spot(Where.SPRING, k), unit[a] - unit[b]) for k, (a, b) in enumerate(structure.links)]
        tips = structure.tip
        found += [(Spot(Where.PAIR, i, j), unit[tips[i]] - unit[tips[j]]) for i, j in structure.pairs]
        return cls(tuple(s for s, _ in found), np.array([v for _, v in found]).T)

    @cached_property
    def number(self) -> dict[Spot, int]:
        """Where each place stands."""
        return {spot: k for k, spot in enumerate(self.spots)}


def colours(omega: Float64, corner: float) -> Float64:
    """(F, 2) power of the two kinds of unknown force over frequency; ``corner`` [rad/s]."""
    out: Float64 = np.stack((1.0 / (1.0 + (omega / corner) ** 2), np.ones(omega.size)), axis=1)
    return out


@dataclass(frozen=True, eq=False)
class MissingNoise:
    """Covariance of the missing torque on F lines, and its parts.

    ``covariance`` (F, M, M): S. ``reach`` (F, M, P): H. ``power`` (F, P): q_p g.
    """

    covariance: Complex128
    reach: Complex128
    power: Float64

    @cached_property
    def whitener(self) -> Complex128:
        """(F, M, M) W with W S Wᴴ = 1."""
        size = np.sqrt(np.einsum("fii->fi", self.covariance).real)
        scaled = self.covariance / size[:, :, None] / size[:, None, :]
        lower = np.linalg.cholesky(scaled)
        out: Complex128 = np.linalg.inv(lower) / size[:, None, :]
        return out

    @cached_property
    def log_determinant(self) -> Float64:
        """(F,) ln|S|."""
        out: Float64 = -2.0 * np.log(np.abs(np.einsum("fii->fi", self.whitener))).sum(axis=1)
        return out


def missing_noise(
    stiffness: Complex128, reach: Complex128, power: Float64, sensors: tuple[Float64, Float64]
) -> MissingNoise:
    """S = Z C_θ Zᴴ + C_τ + Σ_p q_p g H_p H_pᴴ for sensors' noise (C_θ, C_τ), (M,) each."""
    position, torque = sensors
    turned = stiffness.conj().transpose(0, 2, 1)
    covariance = (reach * power[:, None]) @ reach.conj().transpose(0, 2, 1)
    covariance = covariance + (stiffness * position) @ turned + np.diag(torque)
    return MissingNoise(covariance, reach, power)
