"""The test behind ``compare``: all parameters at once, in coordinates where the noise is white.

The difference Δ of two parameter vectors has covariance D = λ²(C₁ + C₂): the joint covariances of both
fits, inflated by the repeatability λ that the cell's own history shows. Parameters of one fit are strongly
correlated, so one by one they would show little, and name the neighbours of what changed. Instead the
smallest set of changes that explains Δ is built up, one parameter at a time: each step tests every
remaining parameter with those already found fitted (a score test of generalised least squares) and takes
the best if it is significant after Holm's correction over all of them. With a diagonal D this *is* Holm's
step-down procedure. A rival that explains the difference about as well is never ruled out in silence.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import special

from invid.arrays import Float64
from invid.compare_change import Repeatability
from invid.distributions import chi2_isf, chi2_sf, f_sf, normal_isf
from invid.model import Model, parameter_vector

RIVAL = normal_isf(0.005) ** 2
"""A rival whose χ² is no worse than this below the best is not ruled out: 6.6, a likelihood ratio of 28."""
_FLOOR = 1e-9
"""Smallest eigenvalue of a correlation matrix: below it a direction is rounding, not information."""
_NEGATIVE = 1e-6
"""An eigenvalue further below zero than rounding explains: the matrix is no covariance."""
POWER = 0.9
"""Chance with which a change is found that is called detectable."""
MINIMUM_PAIRS = 2
_DECIDES = 1e-3
"""Where a threshold of the test lies (two-sided, a few parameters, 1 %): a cell that repeats better than its
fits say is believed once that, with what its few runs leave open, makes the test sharper there."""
_LEAST_FACTOR = 0.5
"""A guess: fits that claim more than twice the scatter are not believed to be that wrong."""
_SPANNING_PAIRS = 3
"""Pairs needed before one that may hold the change itself is let into the median."""


def stds_by_name(model: Model) -> dict[str, float]:
    """Standard deviation by the names of ``parameter_vector``; a coupling under both orders of its axes."""
    out: dict[str, float] = {}
    for i, axis in enumerate(model.axes):
        for kind, column in (
            ("mass", model.std.masses[i]),
            ("spring", model.std.springs[i]),
            ("damper", model.std.dampers[i]),
        ):
            out.update({f"{axis}.{kind}.{q + 1}": float(s) for q, s in enumerate(column)})
        out[f"{axis}.ground_spring"] = float(model.std.ground_springs[i])
    for i, first in enumerate(model.axes):
        for j in range(i + 1, len(model.axes)):
            second, value = model.axes[j], float(model.std.couplings[i, j])
            out[f"{first}-{second}.coupling"] = out[f"{second}-{first}.coupling"] = value
    return out


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


def detectable(white: Whitened, alpha: float, dof: float) -> Float64:
    """(n,) size of a change in one parameter alone that ``select`` would find in 90 of 100 times."""
    share = alpha / (2 * white.data.size)
    threshold = normal_isf(share) if math.isinf(dof) else _t_isf(share, dof)
    result: Float64 = (threshold + normal_isf(1 - POWER)) * white.sharpest()
    return result


def _t_isf(p: float, dof: float) -> float:
    """t that is exceeded with probability ``p``."""
    return -float(special.stdtrit(dof, p))


def select(white: Whitened, alpha: float, dof: float) -> Selection:
    """The smallest set of changes that explains Δ, family-wise at ``alpha``."""
    count = white.data.size
    chosen: list[int] = []
    rivals: dict[int, tuple[int, ...]] = {}
    p, adjusted = [1.0] * count, [1.0] * count
    running = 0.0
    while True:
        z = white.scores(chosen)
        left = [k for k in range(count) if k not in chosen]
        if not left:
            break
        best = max(left, key=lambda k: abs(z[k]))
        for k in left:
            p[k] = two_sided(float(z[k]), dof)
            adjusted[k] = max(running, min(1.0, len(left) * p[k]))
        if adjusted[best] >= alpha:
            break
        running = adjusted[best]
        close = [k for k in left if k != best and z[k] ** 2 > z[best] ** 2 - RIVAL]
        # A parameter that is merely off by chance beside the best is no rival: a rival takes its place.
        rivals[best] = tuple(
            k
            for k in close
            if (len(left) - 1) * two_sided(float(white.scores([*chosen, k])[best]), dof) >= alpha
        )
        chosen.append(best)
    return Selection(tuple(chosen), rivals, tuple(p), tuple(adjusted))


def joint_p(white: Whitened, dof: float) -> float:
    """p of "nothing at all changed"."""
    count = white.data.size
    return (
        chi2_sf(white.chi2, count) if math.isinf(dof) else f_sf(white.chi2 / count, float(count), float(dof))
    )


# --- repeatability -----------------------------------------------------------------------------------
def repeatability(history: Sequence[Model], *, spanning: tuple[Model, Model] | None = None) -> Repeatability:
    """λ from pairs of consecutive models, oldest first.

    The median over pairs, so that a change of tool in a minority of them does not count as bad
    repeatability. ``spanning``: the two models being compared; what lies between them may hold the very
    change, so it is let in only where there are enough pairs for a median that one of them cannot move,
    and the pair itself never is.
    """
    outside: list[tuple[float, int]] = []
    between: list[tuple[float, int]] = []
    inside = False
    for old, new in pairwise(history):
        if spanning is not None:
            inside = (inside or old in spanning) and not (inside and old in spanning)
            if old in spanning and new in spanning:
                continue
        found = _misfit(old, new)
        if found is not None:
            (between if inside else outside).append(found)
    used = outside + between if len(outside) + len(between) >= _SPANNING_PAIRS else outside
    return scatter_of(used, low=bool(between))


def scatter_of(misfits: Sequence[tuple[float, int]], *, low: bool = False) -> Repeatability:
    """λ from χ² and degrees of freedom of pairs; ``low``: the lower of two middle ones is the median."""
    if len(misfits) < MINIMUM_PAIRS:
        return Repeatability(pairs=len(misfits))
    # χ² over its own median, not its mean: unbiased also for few parameters.
    ratios = sorted(chi2 / chi2_isf(0.5, count) for chi2, count in misfits)
    factor = math.sqrt(ratios[(len(ratios) - 1) // 2] if low else float(np.median(ratios)))
    # Consecutive pairs share a model, and a median is two thirds as efficient as a mean: half remains.
    dof = max(1.0, 0.5 * sum(count for _, count in misfits))
    if factor <= 1.0:
        # One standard deviation of its logarithm up: a factor that came out small by chance raises alarms.
        factor *= math.exp(1.0 / math.sqrt(2.0 * dof))
        if factor * _t_isf(_DECIDES, dof) >= normal_isf(_DECIDES):
            return Repeatability(1.0, len(misfits))
    return Repeatability(max(factor, _LEAST_FACTOR), len(misfits), dof)


def _misfit(old: Model, new: Model) -> tuple[float, int] | None:
    """χ² of two models being the same robot, and its degrees of freedom."""
    white = difference(old, new)
    return None if white is None else (white.chi2, white.data.size)


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
