"""The fit of one set of terms, and by how much −2 ln L falls from one to another."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from invid.effects.large_motion.load_dependent_friction import LoadFrictionLaw
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.value import bounded_minimum
from invid.numerics.arrays import Bool, Float64
from invid.rigid_motion.rows import Rows
from invid.rigid_motion.terms import GRAVITY, LOADS, Base, Term, load_on

FALSE_ALARM = 0.01
"""Chance that noise alone passes for something on an axis (statistical)."""
RESOLUTION = 0.005
"""Share of the torque below which nothing counts as missing. Empirical: resampling, differentiation and held
torque leave up to 0.2 % on simulated axes without a cause."""
FOLDS = 40
"""Most fits without a piece; neighbours go out together, so that a fold is longer than a correlation."""
ROUNDS = 4
"""Times that the unknown force is estimated beside the terms, which settles it (numerical)."""
LEAST_PIECES = 3
"""Pieces from which on one may be left out (statistical)."""
RIDGE = 1e-11
"""Of columns of unit length (numerical)."""
LEAST_VARIATION = 0.1
"""Spread of |load| over its mean below which it counts as constant. Physical: |load|·sign(v) is then Coulomb
friction to a tenth."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A fit of one set of terms.

    ``held_out`` is the residual of every row as a fit that has not seen it predicts it: a validation row by
    the fit to all training rows, a training row by the fit to the pieces beside its own.
    """

    terms: list[Term]
    value: Float64
    free: Bool
    """(k,) coefficients that are not at a bound."""
    covariance: Float64
    residual: Float64
    held_out: Float64
    strength: Float64
    """(M,) of the unknown force."""
    effective: float
    """Independent rows behind the training rows."""
    fitted: float
    kept: float
    """−2 ln L of the rows fitted and of rows kept out, where what is in no term may be another."""

    def span(self, term: Term) -> slice:
        """Where a term's coefficients are."""
        start = 0
        for t in self.terms:
            if t is term:
                return slice(start, start + len(t.low))
            start += len(t.low)
        raise KeyError(term.cause)

    def of(self, term: Term) -> tuple[Float64, Float64]:
        """Coefficients of one term and their standard deviations."""
        part = self.span(term)
        return self.value[part], np.sqrt(np.maximum(np.diag(self.covariance)[part], 0.0))

    @cached_property
    def numbers(self) -> int:
        """Coefficients that are not at a bound, and shapes of terms that have one."""
        shapes = sum(len(t.shape) for t in self.terms if self.free[self.span(t)].any())
        return int(self.free.sum()) + shapes


def fit_terms(rows: Rows, terms: list[Term]) -> Fit:
    """The coefficients within their bounds that leave the least, each axis weighed by what it leaves.

    Weighed by the colour as well, what a wrong law leaves at low frequencies would cost nothing.
    """
    matrix, torque, train = rows.matrix(terms), rows.torque, rows.train
    low = np.array([b for t in terms for b in t.low])
    residual = torque
    for _ in range(1 if rows.axes == 1 else ROUNDS):
        weight = 1.0 / np.sqrt(np.maximum(axis_powers(rows, train, residual), 1e-300))[rows.axis]
        a, b = matrix * weight[:, None], torque * weight
        size = np.maximum(np.linalg.norm(a[train], axis=0), 1e-300)
        a = a / size
        normal, right = a[train].T @ a[train], a[train].T @ b[train]
        scaled, free = bounded_minimum(normal, -right, (low * size, np.full(low.size, np.inf)))
        residual = torque - matrix @ (scaled / size)
    held_out = residual.copy()
    ridged = (normal + RIDGE * np.eye(low.size))[np.ix_(free, free)]
    known = b - a[:, ~free] @ scaled[~free]
    for fold in _folds(rows):
        own = a[fold][:, free]
        left = a[train][:, free].T @ known[train] - own.T @ known[fold]
        full = scaled.copy()
        full[free] = scipy.linalg.solve(ridged - own.T @ own, left, assume_a="sym")
        held_out[fold] = torque[fold] - matrix[fold] @ (full / size)
    strength = np.sqrt(np.maximum(axis_powers(rows, train, residual), 1e-300))
    return Fit(
        terms,
        scaled / size,
        free,
        covariance_of(rows, matrix, strength),
        residual,
        held_out,
        strength,
        float(rows.independent.sum()),
        _total(rows, train, residual),
        _total(rows, rows.judged, held_out),
    )


def _total(rows: Rows, asked: Bool, left: Float64) -> float:
    """−2 ln L of some rows but for a constant, the unknown force as strong as they show."""
    power = axis_powers(rows, asked, rows.colour.whitened(rows, left))
    counts = np.bincount(rows.axis[asked], minlength=rows.axes)
    return float(counts @ np.log(np.maximum(power, 1e-300)))


def _folds(rows: Rows) -> list[Bool]:
    numbers = np.unique(rows.group[rows.train])
    if numbers.size < 3:
        return []
    return [rows.train & np.isin(rows.group, s) for s in np.array_split(numbers, min(FOLDS, numbers.size))]


def falls(rows: Rows, before: Fit, after: Fit) -> tuple[float, float]:
    """Falls of −2 ln L on the rows fitted and on rows kept out, the unknown force as strong as either shows.

    The piece that gains most is left out: what stands on it alone is an event, not a cause.
    """
    out = []
    for asked, kind in ((rows.train, "residual"), (rows.judged, "held_out")):
        left = [rows.colour.whitened(rows, getattr(f, kind))[asked] ** 2 for f in (before, after)]
        pieces = np.unique(rows.group[asked], return_inverse=True)[1]
        gains = np.bincount(pieces, (left[0] - left[1]) / after.strength[rows.axis[asked]] ** 2)
        kept = pieces != np.argmax(gains) if gains.size > LEAST_PIECES else np.ones(pieces.size, dtype=bool)
        axis = rows.axis[asked][kept]
        sums = [np.maximum(np.bincount(axis, x[kept], rows.axes), 1e-300) for x in left]
        out.append(float(np.bincount(axis, minlength=rows.axes) @ np.log(sums[0] / sums[1])))
    return out[0], out[1]


def axis_powers(rows: Rows, asked: Bool, x: Float64) -> Float64:
    """(M,) mean square of some rows of each axis."""
    counts = np.bincount(rows.axis[asked], minlength=rows.axes)
    out: Float64 = np.bincount(rows.axis[asked], x[asked] ** 2, rows.axes) / np.maximum(counts, 1)
    return out


def noise_of(rows: Rows, result: Fit) -> Float64:
    """(rows,) variance that white noise of torque and position alone leaves in each row."""
    variance = rows.noise.copy()
    for term in result.terms:
        if term.law is Base.INERTIA:
            mass = float(result.of(term)[0][0])
            own = rows.axis == term.axis
            variance[own] += mass**2 * float(rows.motions[0].band.accelerating()[term.axis])
    return variance


def axes_at_noise(rows: Rows, result: Fit) -> Bool:
    """(M,) axes whose unseen rows hold no more than noise or sampling leaves: nothing is asked there."""
    count = np.maximum(rows.independent, 1.0)
    most = scipy.stats.chi2.isf(FALSE_ALARM, count) / count
    floor = axis_powers(rows, rows.judged, np.sqrt(noise_of(rows, result)))
    sampled = RESOLUTION**2 * axis_powers(rows, rows.judged, rows.torque)
    quiet: Bool = axis_powers(rows, rows.judged, result.held_out) <= np.maximum(most * floor, sampled)
    return quiet


def load_terms(rows: Rows, current: Fit) -> list[Term]:
    """Friction of the load on every axis whose load varies: by weight alone, and with what accelerates."""
    found = [_loaded(current, law, axis) for law in LOADS for axis in range(rows.axes)]
    return [t for t in found if t is not None and _load_variation(rows, t) > LEAST_VARIATION]


def _loaded(current: Fit, law: LoadFrictionLaw, axis: int) -> Term | None:
    inertial = (Base.INERTIA, Base.COUPLING, Base.CONFIGURATION, Part.OFFSET) if law.whole else ()
    acting = [t for t in current.terms if axis in t.axes and t.law in (GRAVITY, *inertial)]
    load = tuple((t, tuple(float(v) for v in current.of(t)[0])) for t in acting)
    return Term(law, axis, load=load) if load else None


def _load_variation(rows: Rows, term: Term) -> float:
    """Spread of |load| over its mean, over the rows' motion; 0 where constant velocity shows one load."""
    sizes = np.concatenate([np.abs(load_on(term, m)) for m in rows.motions])
    moving = np.concatenate([np.abs(m.velocity[:, term.axis]) > m.rest[term.axis] for m in rows.motions])
    if moving.sum() < 2:
        return 0.0
    mean = float(sizes[moving].mean())
    return float(sizes[moving].std()) / mean if mean > 0 else 0.0


def settled(rows: Rows, terms: list[Term]) -> Fit:
    """The fit in which every load is that of the fit itself."""
    current = fit_terms(rows, terms)
    for _ in range(ROUNDS if any(t.load for t in terms) else 0):
        terms = [_reloaded(t, current) for t in terms]
        current = fit_terms(rows, terms)
    return current


def _reloaded(term: Term, current: Fit) -> Term:
    if not isinstance(term.law, LoadFrictionLaw):
        return term
    return replace(term, load=(_loaded(current, term.law, term.axis) or term).load)


def joint_covariance(rows: Rows, result: Fit) -> tuple[Float64, list[Term]]:
    """Covariance of all coefficients and of the first shape of each term that has one, and these terms."""
    shaped = [t for t in result.terms if t.shape]
    slopes = []
    for term in shaped:
        up, down = (
            rows.columns(replace(term, shape=(term.shape[0] + h, *term.shape[1:]))) for h in (1e-3, -1e-3)
        )
        slopes.append((up - down) @ result.of(term)[0] / 2e-3)
    matrix = np.column_stack([rows.matrix(result.terms), *slopes])
    return covariance_of(rows, matrix, result.strength), shaped


def covariance_of(rows: Rows, matrix: Float64, strength: Float64) -> Float64:
    """Covariance of the coefficients of columns (rows, k), the rows as many as are independent."""
    counts = np.bincount(rows.axis[rows.train], minlength=rows.axes)
    spread = strength * np.sqrt(counts / rows.independent)
    a = (matrix / spread[rows.axis, None])[rows.train]
    size = np.linalg.norm(a, axis=0)
    size[size == 0] = 1.0
    inverse = np.linalg.pinv((a / size).T @ (a / size), rcond=1e-12, hermitian=True)
    count = float(rows.independent.sum())
    out: Float64 = inverse * count / max(count - a.shape[1], 1.0) / np.outer(size, size)
    return out
