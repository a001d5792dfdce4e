"""The fit of one set of terms, and by how much −2 ln L falls from one to another."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import scipy

from invid.effects.large_motion.load_dependent_friction import LoadFrictionLaw
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.value import bounded_minimum
from invid.numerics.arrays import Bool, Float64, Int64
from invid.rigid_motion.rows import ENOUGH, Rows
from invid.rigid_motion.terms import GRAVITY, LOADS, Base, Term, load_on, torque_of

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
DRAWS = 4000
"""Draws of signs in a test (numerical: a chance of 0.1 is told to 0.005)."""
FIRST_PRECISION, PRECISION_ROUNDS, LEAST_TOLD = 1e-3, 5, 1e-3
"""Of carried weights: where their precision begins, how often it is told anew, and the least of numbers that
the data tell of them (numerical)."""
RIDGE = 1e-11
"""Of columns of unit length (numerical)."""
LEAST_VARIATION = 0.1
"""Spread of |load| over its mean below which it counts as constant. Physical: |load|·sign(v) is then Coulomb
friction to a tenth."""


Folds = list[tuple[Int64, Float64]]
"""Pieces that go out together, and the coefficients of the fit to the others."""


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
    folds: Folds
    strength: Float64
    """(M,) of the unknown force."""
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

    @property
    def parts(self) -> list[tuple[Term, Float64]]:
        """Every term with its coefficients."""
        return [(t, self.value[self.span(t)]) for t in self.terms]

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
        normal = normal + np.diag(_precisions(rows, terms, normal, right))
        scaled, free = bounded_minimum(normal, -right, (low * size, np.full(low.size, np.inf)))
        residual = torque - matrix @ (scaled / size)
    ridged = (normal + RIDGE * np.eye(low.size))[np.ix_(free, free)]
    known = b - a[:, ~free] @ scaled[~free]
    folds = []
    for groups in _folds(rows):
        fold = train & np.isin(rows.group, groups)
        own = a[fold][:, free]
        left = a[train][:, free].T @ known[train] - own.T @ known[fold]
        full = scaled.copy()
        full[free] = scipy.linalg.solve(ridged - own.T @ own, left, assume_a="sym")
        folds.append((groups, full / size))
    held_out = unseen(rows, terms, scaled / size, folds)
    strength = np.sqrt(np.maximum(axis_powers(rows, train, residual), 1e-300))
    return Fit(
        terms,
        scaled / size,
        free,
        covariance_of(rows, matrix, strength),
        residual,
        held_out,
        folds,
        strength,
        _total(rows, train, residual),
        _total(rows, rows.judged, held_out),
    )


def _precisions(rows: Rows, terms: list[Term], normal: Float64, right: Float64) -> Float64:
    """(k,) that coefficients of carried weights have before the data, of columns of unit length; 0 of others.

    All that one axis carries has one, the most likely (MacKay, Neural Computation 4(3), 1992): many shapes of
    which few data tell are else anything.
    """
    counts = np.bincount(rows.axis[rows.train], minlength=rows.axes)
    precision, start = np.zeros(len(normal)), 0
    spans = []
    for term in terms:
        if term.law is Base.CARRIED:
            spans.append(
                (slice(start, start + len(term.low)), counts[term.axis] / rows.independent[term.axis])
            )
        start += len(term.low)
    for part, _ in spans:
        precision[part] = FIRST_PRECISION
    for _ in range(PRECISION_ROUNDS if spans else 0):
        inverse = scipy.linalg.pinvh(normal + np.diag(precision + RIDGE))
        value = inverse @ right
        for part, alike in spans:
            told = len(value[part]) - precision[part][0] * np.trace(inverse[part, part])
            precision[part] = max(told, LEAST_TOLD) * alike / np.sum(value[part] ** 2)
    return precision


def _total(rows: Rows, asked: Bool, left: Float64) -> float:
    """−2 ln L of some rows but for a constant, the unknown force as strong as they show."""
    power = axis_powers(rows, asked, rows.colour.whitened(rows, left))
    counts = np.bincount(rows.axis[asked], minlength=rows.axes)
    return float(counts @ np.log(np.maximum(power, 1e-300)))


def _folds(rows: Rows) -> list[Int64]:
    numbers = np.unique(rows.group[rows.train])
    return [] if numbers.size < LEAST_PIECES else np.array_split(numbers, min(FOLDS, numbers.size))


def unseen(rows: Rows, terms: list[Term], value: Float64, folds: Folds) -> Float64:
    """(rows,) residual of each row by coefficients that have not seen it: of ``folds``, else ``value``."""
    matrix = rows.matrix(terms)
    out: Float64 = rows.torque - matrix @ value
    for groups, known in folds:
        own = rows.train & np.isin(rows.group, groups)
        out[own] = rows.torque[own] - matrix[own] @ known
    return out


def missing_torque(rows: Rows, result: Fit) -> Float64:
    """(every row,) torque that the measured motion needs beyond a fit that has not seen it.

    Where an axis stands its dry friction may be anything between what it is either way: of that nothing is
    missing.
    """
    least, most = [], []
    for m in rows.motions:
        speed = np.maximum(np.abs(m.velocity), 2.0 * m.rest)
        # What leaps from stand to stand (values that repeat) moves, and shows nothing but stands.
        leaps = (m.still.mean(axis=0) >= ENOUGH) & (np.abs(m.velocity).mean(axis=0) > m.rest)
        stands = m.still & ~leaps
        told, *ends = (
            torque_of(result.parts, replace(m, velocity=v))
            for v in (m.velocity, *(np.where(stands, way * speed, m.velocity) for way in (-1.0, 1.0)))
        )
        least.append(m.whole().rows(np.min(ends, axis=0) - told))
        most.append(m.whole().rows(np.max(ends, axis=0) - told))
    left = unseen(rows.every, result.terms, result.value, result.folds)
    return left - np.clip(left, rows.every.stack(least), rows.every.stack(most))


def falls(before: Fit, after: Fit) -> tuple[float, float]:
    """Falls of −2 ln L on rows fitted and on rows kept out, the unknown force as strong as either shows."""
    return before.fitted - after.fitted, before.kept - after.kept


def chance_of_gain(rows: Rows, left: tuple[Float64, Float64], axis: int) -> float:
    """Chance that pieces of every row kept out gain as much on an axis without any cause: that gains of these
    sizes and of either sign sum up to as much (randomisation test, which one large gain does not decide).

    ``left`` (every row,): what is missing before and after. Whitened, since slow parts of an unknown force
    else drown a gain, or as it stands, where whitening leaves of slow friction its edges alone: then in no
    more pieces than rows are independent. 1 where it is no less as it stands.
    """
    mine = rows.every.judged & (rows.every.axis == axis)
    plain, white = (
        [f(x)[mine] for x in left] for f in (np.asarray, partial(rows.colour.whitened, rows.every))
    )
    piece = np.unique(rows.every.group[mine], return_inverse=True)[1]
    count = int(piece.max()) + 1
    fewer = piece * max(min(int(rows.independent[axis]), count), 1) // count
    gains = [
        np.bincount(own, before**2 - after**2) for own, (before, after) in ((piece, white), (fewer, plain))
    ]
    if gains[1].sum() <= 0:
        return 1.0
    draw = np.random.default_rng(0)
    signs = (draw.choice((-1.0, 1.0), (DRAWS, g.size)) for g in gains)
    return min(
        float(np.mean(s @ np.abs(g) >= g.sum() * (1.0 - 1e-9))) for s, g in zip(signs, gains, strict=True)
    )


def axis_powers(rows: Rows, asked: Bool, x: Float64) -> Float64:
    """(M,) mean square of some rows of each axis."""
    counts = np.bincount(rows.axis[asked], minlength=rows.axes)
    out: Float64 = np.bincount(rows.axis[asked], x[asked] ** 2, rows.axes) / np.maximum(counts, 1)
    return out


def noise_powers(rows: Rows, result: Fit, *, at_worst: bool = False) -> Float64:
    """(M,) mean square that white noise of torque and position leaves in rows kept out.

    ``at_worst``: with the counts of the encoder. At a constant speed rounding is no white noise but a tone,
    wherever the sampling aliases it to: at worst all of it, count²/12, at the cut-off.
    """
    band, counts = rows.motions[0].band, np.max([m.counts for m in rows.motions], axis=0)
    felt = band.accelerating() + at_worst * (2 * np.pi * band.rows_hz) ** 4 * counts**2 / 12.0
    power = axis_powers(rows, rows.judged, np.sqrt(rows.noise))
    for term in result.terms:
        if term.law is Base.INERTIA:
            power[term.axis] += float(result.of(term)[0][0]) ** 2 * felt[term.axis]
    return power


def axes_at_noise(rows: Rows, result: Fit, left: Float64 | None = None) -> Bool:
    """(M,) axes whose rows kept out hold no more than noise, counts and sampling leave: all is said.

    ``left`` (rows,): what the rows hold, where it is not the fit's own.
    """
    count = np.maximum(rows.independent, 1.0)
    most = scipy.stats.chi2.isf(FALSE_ALARM, count) / count * noise_powers(rows, result, at_worst=True)
    sampled = RESOLUTION**2 * axis_powers(rows, rows.judged, rows.torque)
    quiet: Bool = axis_powers(rows, rows.judged, result.held_out if left is None else left) <= np.maximum(
        most, sampled
    )
    return quiet


def missing_powers(rows: Rows, result: Fit) -> Float64:
    """(M,) power that rows kept out miss beyond noise."""
    return axis_powers(rows, rows.judged, result.held_out) - noise_powers(rows, result)


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
