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

from invid.model.document import Model, parameter_vector, stds_by_name
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


def covariance_of(model: Model, names: Sequence[str]) -> Float64:
    """(n, n) covariance of named linear parameters: the joint one where the model has it, else diagonal.

    A model's std (which may carry more than the fit's own covariance) stays; correlation is added.
    """
    stds = stds_by_name(model)
    spread = np.array([stds.get(n, math.nan) for n in names])
    result: Float64 = np.diag(spread**2)
    joint = model.covariance
    if joint is None or joint.shape != (len(model.parameter_names),) * 2:
        return result
    at = _positions(model)
    known = [k for k, n in enumerate(names) if n in at]
    rows = [at[names[k]] for k in known]
    block = joint[np.ix_(rows, rows)]
    own = np.sqrt(np.clip(np.diag(block), 0, None))
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = block / np.outer(own, own) * np.outer(spread[known], spread[known])
    target = result[np.ix_(known, known)]
    good = np.isfinite(scaled)
    target[good] = scaled[good]
    np.fill_diagonal(target, spread[known] ** 2)
    result[np.ix_(known, known)] = target
    return result


def _positions(model: Model) -> dict[str, int]:
    at: dict[str, int] = {}
    for k, name in enumerate(model.parameter_names):
        at[name] = k
        pair, _, kind = name.partition(".")
        first, _, second = pair.partition("-")
        if kind == "coupling" and second:
            at[f"{second}-{first}.coupling"] = k
    return at


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

    def sharpest(self) -> Float64:
        """(n,) standard deviation of each change with everything else unchanged."""
        return np.asarray(self.std / np.linalg.norm(self.columns, axis=0), dtype=float)

    def sizes(self, chosen: Sequence[int]) -> tuple[Float64, Float64]:
        """Changes of ``chosen`` with everything else unchanged, and their standard deviations."""
        basis = self.columns[:, list(chosen)]
        inverse = np.linalg.pinv(basis.T @ basis)
        scale = self.std[list(chosen)]
        return inverse @ basis.T @ self.data * scale, np.sqrt(np.diag(inverse)) * scale


@dataclass(frozen=True)
class Selection:
    """``chosen`` in the order found, the ``rivals`` of each, p of every parameter, plain and by Holm."""

    chosen: tuple[int, ...]
    rivals: Mapping[int, tuple[int, ...]]
    p: tuple[float, ...]
    p_adjusted: tuple[float, ...]

    def doubtful(self) -> dict[int, list[int]]:
        """Parameters of which one or another changed: each with its rivals.

        A rival that a later step found changed in its own right is no rival any more.
        """
        found: dict[int, list[int]] = {}
        for best, others in self.rivals.items():
            still = [o for o in others if o not in self.chosen]
            if still:
                group = [best, *still]
                for k in group:
                    found.setdefault(k, []).extend(o for o in group if o != k)
        return found


def two_sided(z: float, dof: float) -> float:
    """Chance of a larger |z| (normal), or of a larger |t| where the scale itself was estimated."""
    tail = special.ndtr(-abs(z)) if math.isinf(dof) else special.stdtr(dof, -abs(z))
    return 2.0 * float(tail)


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
    low, high = -(top**2) / 2, 30.0 * top
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if spent(middle).sum() > alpha else (low, middle)
    best = spent(high)
    total = float(best.sum())
    equal = np.full(count, 1.0 / count)
    result: Float64 = _EQUAL * equal + (1 - _EQUAL) * (best / total if total > 0 else equal)
    return result


def detectable(white: Whitened, alpha: float, dof: float, runs: tuple[int, int]) -> Float64:
    """(n,) size of a change in one parameter alone that ``select`` would find in 90 of 100 times."""
    share = alpha * shares(white, alpha, runs) / 2
    threshold = -(special.ndtri(share) if math.isinf(dof) else special.stdtrit(dof, share))
    result: Float64 = (threshold + normal_isf(1 - POWER)) * white.sharpest()
    return result


def select(white: Whitened, alpha: float, dof: float, runs: tuple[int, int] | None = None) -> Selection:
    """The smallest set of changes that explains Δ, family-wise at ``alpha``; ``runs`` behind either side
    share it out (``shares``), without them it is shared equally."""
    count = white.data.size
    share = np.full(count, 1.0 / count) if runs is None else shares(white, alpha, runs)
    chosen: list[int] = []
    rivals: dict[int, tuple[int, ...]] = {}
    p, adjusted = [1.0] * count, [1.0] * count
    running = 0.0
    while True:
        z = white.scores(chosen)
        left = [k for k in range(count) if k not in chosen]
        if not left:
            break
        whole = float(share[left].sum())
        for k in left:
            p[k] = two_sided(float(z[k]), dof)
            adjusted[k] = max(running, min(1.0, p[k] * whole / float(share[k])))
        found = [k for k in left if adjusted[k] < alpha]
        if not found:
            break
        # Whether anything changed is a matter of the shares; what it was, of the data alone.
        best = max(found, key=lambda k: abs(z[k]))
        running = adjusted[best]
        close = [k for k in left if k != best and z[k] ** 2 > z[best] ** 2 - RIVAL]
        # A parameter that is merely off by chance beside the best is no rival: a rival takes its place.
        rivals[best] = tuple(
            k
            for k in close
            if two_sided(float(white.scores([*chosen, k])[best]), dof)
            * (whole - float(share[k]))
            / float(share[best])
            >= alpha
        )
        chosen.append(best)
    return Selection(tuple(chosen), rivals, tuple(p), tuple(adjusted))


def joint_p(white: Whitened, dof: float) -> float:
    """Return the p value of "nothing at all changed"."""
    count = white.data.size
    return (
        chi2_sf(white.chi2, count) if math.isinf(dof) else f_sf(white.chi2 / count, float(count), float(dof))
    )


def difference(old: Model, new: Model, factor: float = 1.0) -> Whitened | None:
    """new − old over the linear parameters that both know, its deviations ``factor`` times what the fits say.

    ``None`` where the two have different parameters, or no covariance to judge them by.
    """
    names_old, was = parameter_vector(old.chains)
    names_new, now = parameter_vector(new.chains)
    if names_old != names_new or old.linear != new.linear:
        return None
    stds = stds_by_name(old), stds_by_name(new)
    keep = [k for k, n in enumerate(names_old) if all(s.get(n, math.nan) > 0 for s in stds)]
    if not keep:
        return None
    names = [names_old[k] for k in keep]
    covariance = factor**2 * (covariance_of(old, names) + covariance_of(new, names))
    white, sound = Whitened.of((now - was)[keep], covariance)
    return white if sound else None
