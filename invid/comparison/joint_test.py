"""Test all parameters of two models at once, in coordinates where the noise is white.

The difference Δ of two parameter vectors has covariance D = λ²(C₁ + C₂): the joint covariances of both
fits, inflated by the repeatability λ that the cell's own history shows. Parameters of one fit are strongly
correlated, so one by one they would show little, and name the neighbours of what changed. Instead the
smallest set of changes that explains Δ is built up, one parameter at a time: each step tests every
remaining parameter with those already found fitted (a score test of generalised least squares) and takes
the best if it is significant after Holm's correction over all of them, weighted (``shares``). With a
diagonal D this *is* Holm's step-down procedure. A rival that explains the difference about as well is never
ruled out in silence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special
from scipy.optimize import brentq

from invid.numerics.arrays import Float64
from invid.numerics.distributions import chi2_sf, f_sf, normal_isf

RIVAL = normal_isf(0.005) ** 2
"""A rival whose χ² is no worse than this below the best is not ruled out: 6.6, a likelihood ratio of 28."""
_FLOOR = 1e-9
"""Smallest eigenvalue of a correlation matrix: below it a direction is rounding, not information."""
_NEGATIVE = 1e-6
"""An eigenvalue further below zero than rounding explains: the matrix is no covariance."""
POWER = 0.9
"""Chance with which a change is found that is called detectable."""
SOUGHT = 3.0
"""Size, in standard deviations of one run, of the change for which the thresholds are shared out."""
_EQUAL = 0.5
"""Part of the false alarms that every parameter gets in equal shares, whatever it is correlated with: none
asks for more than twice the evidence (in p) of an equal share."""


@dataclass(frozen=True, eq=False)
class Whitened:
    """Δ and the unit vectors of the parameters in white coordinates; ``std`` (n,) of Δ."""

    columns: Float64
    data: Float64
    std: Float64

    @classmethod
    def of(cls, delta: Float64, covariance: Float64) -> tuple[Whitened, bool]:
        """Whitened ``delta`` (n,); False where ``covariance`` (n, n) is none and its diagonal has to do."""
        std = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(std, std)
        values, vectors = np.linalg.eigh((correlation + correlation.T) / 2)
        sound = bool(values[0] > -_NEGATIVE)
        if not sound:
            values, vectors = np.ones(std.size), np.eye(std.size)
        columns = (vectors / np.sqrt(np.maximum(values, _FLOOR))).T
        return cls(columns, columns @ (delta / std), std), sound

    @property
    def chi2(self) -> float:
        """Sum of squares: χ² with as many degrees of freedom as parameters where nothing changed."""
        return float(self.data @ self.data)

    def scores(self, chosen: Sequence[int]) -> Float64:
        """(n,) signed z of every parameter with ``chosen`` fitted; 0 for those that are chosen."""
        columns, residual = self.columns, self.data
        if chosen:
            basis, _ = np.linalg.qr(self.columns[:, list(chosen)])
            residual = residual - basis @ (basis.T @ residual)
            columns = columns - basis @ (basis.T @ columns)
        length = np.linalg.norm(columns, axis=0)
        seen = length > 1e-6 * np.linalg.norm(self.columns, axis=0)
        z: Float64 = np.where(seen, columns.T @ residual / np.where(seen, length, 1.0), 0.0)
        z[list(chosen)] = 0.0
        return z

    def sizes(self, chosen: Sequence[int]) -> tuple[Float64, Float64]:
        """Changes of ``chosen`` with everything else unchanged, and their standard deviations."""
        basis = self.columns[:, list(chosen)]
        inverse = np.linalg.pinv(basis.T @ basis)
        scale = self.std[list(chosen)]
        return inverse @ basis.T @ self.data * scale, np.sqrt(np.diag(inverse)) * scale


@dataclass(frozen=True)
class Selection:
    """``chosen`` in the order found, the ``rivals`` of each, p of every parameter, plain and by Holm (n,)."""

    chosen: tuple[int, ...]
    rivals: Mapping[int, tuple[int, ...]]
    p: Float64
    p_adjusted: Float64

    def doubtful(self) -> dict[int, list[int]]:
        """Parameters of which one or another changed: each with its rivals.

        A rival that a later step found changed in its own right is no rival any more.
        """
        found: dict[int, list[int]] = {}
        for best, others in self.rivals.items():
            still = [o for o in others if o not in self.chosen]
            for k in [best, *still] if still else ():
                found.setdefault(k, []).extend(o for o in (best, *still) if o != k)
        return found


def two_sided(z: Float64 | float, dof: float) -> Float64:
    """Chance of a larger |t|, of a larger |z| (normal) where ``dof`` is infinite."""
    return np.asarray(2.0 * special.stdtr(dof, -np.abs(z)), dtype=float)


def shares(white: Whitened, alpha: float, runs: tuple[int, int]) -> Float64:
    """(n,) the part of ``alpha`` that each parameter may spend on false alarms, summing to 1.

    A parameter whose error goes along with others' is known much better once those are held, and is found
    at a far stricter threshold; one that stands alone needs every bit. Half is shared equally, half so that
    the expected number found is largest if any one parameter changed by three deviations of repetition, all
    equally likely: with noncentrality δ, z = δ/2 + κ/δ (Spjøtvoll 1972). The shares depend on the covariance
    alone, never on what was measured, so the family-wise rate holds for any of them.
    """
    count = white.data.size
    single = math.sqrt(1 / runs[0] + 1 / runs[1])
    reach = SOUGHT / single * np.linalg.norm(white.columns, axis=0)

    def spent(level: float) -> Float64:
        return np.asarray(2.0 * special.ndtr(-np.maximum(reach / 2 + level / reach, 0.0)), dtype=float)

    # From everything spent (z = 0 everywhere) to next to nothing (z beyond 30 everywhere).
    top = float(reach.max())
    best = spent(float(brentq(lambda level: spent(level).sum() - alpha, -(top**2) / 2, 30.0 * top)))
    return np.asarray(_EQUAL / count + (1 - _EQUAL) * best / best.sum(), dtype=float)


def detectable(white: Whitened, alpha: float, dof: float, runs: tuple[int, int]) -> Float64:
    """(n,) size of a change in one parameter alone that ``select`` would find in 90 of 100 times."""
    threshold = -special.stdtrit(dof, alpha * shares(white, alpha, runs) / 2)
    sharpest = white.std / np.linalg.norm(white.columns, axis=0)
    return np.asarray((threshold + normal_isf(1 - POWER)) * sharpest, dtype=float)


def select(white: Whitened, alpha: float, dof: float, runs: tuple[int, int] | None = None) -> Selection:
    """The smallest set of changes that explains Δ, family-wise at ``alpha``; ``runs`` behind either side
    share it out (``shares``), without them it is shared equally."""
    count = white.data.size
    share = np.full(count, 1.0 / count) if runs is None else shares(white, alpha, runs)
    chosen: list[int] = []
    rivals: dict[int, tuple[int, ...]] = {}
    p, adjusted, running = np.ones(count), np.ones(count), 0.0
    while left := [k for k in range(count) if k not in chosen]:
        z = white.scores(chosen)
        whole = float(share[left].sum())
        p[left] = two_sided(z[left], dof)
        adjusted[left] = np.clip(p[left] * whole / share[left], running, 1.0)
        found = [k for k in left if adjusted[k] < alpha]
        if not found:
            break
        # Whether anything changed is a matter of the shares; what it was, of the data alone.
        best = max(found, key=lambda k: abs(z[k]))
        running = float(adjusted[best])
        close = [k for k in left if k != best and z[k] ** 2 > z[best] ** 2 - RIVAL]
        # A parameter that is merely off by chance beside the best is no rival: a rival takes its place.
        beside = {k: two_sided(white.scores([*chosen, k])[best], dof) * (whole - share[k]) for k in close}
        rivals[best] = tuple(k for k in close if beside[k] / share[best] >= alpha)
        chosen.append(best)
    return Selection(tuple(chosen), rivals, p, adjusted)


def joint_p(white: Whitened, dof: float) -> float:
    """Return the p value of "nothing at all changed"."""
    count = white.data.size
    return chi2_sf(white.chi2, count) if math.isinf(dof) else f_sf(white.chi2 / count, float(count), dof)
