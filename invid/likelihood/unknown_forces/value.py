"""−2 ln L of a plant beside laws and unknown forces, its exact gradient and its curvature.

Per record and line the motors miss the torque

    r = Zθ + V(Σ_j b_j φ_j β_j) + V(α + jωβ_e)·2/T − τ

with laws φ_j of coefficients β_j at places b_j and the record's ends α, β_e. With S from ``forces`` and real
weights w

    −2 ln L = 2 Σ w [rᴴS⁻¹r + ln|S|] − 4 Σ w ln|Z + L|.

The last term, L the torque per position of the records' holds, makes it the density of what was measured with
the drives' commands free (restricted likelihood: the contrast r of motion and torque, whose Jacobian by the
motion is Z + L). Without it lines on which the machine answers an unknown force through plant and hold pull Z
to zero.

The ends are integrated out, with a prior of the size of the motion; the coefficients are profiled out, within
their bounds, by normal equations over all stacks.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from invid.likelihood.unknown_forces.forces import CORNER, LEAST, MissingNoise, Spots, colours, missing_noise
from invid.likelihood.unknown_forces.stack import Stack
from invid.likelihood.unknown_forces.timing import Timing
from invid.model.plant import Condensed, Plant
from invid.numerics.arrays import Bool, Complex128, Float64, Int64


@dataclass(frozen=True, eq=False)
class Column:
    """A law with its coefficient at one.

    ``vector`` (n,) is its place and ``lines`` its transform (R, F) in every stack. ``wide`` gives the
    transform on all lines of a stack up to where motion is known. ``damps``: the motor at which it is viscous
    friction, which belongs to the loop of plant and hold. ``reads``: the motor that stands by ``lines``
    beyond its reading, instead of a force. ``scales``: the motor whose torque, as it acts, it
    multiplies by one plus its coefficient. ``stretch``: mean derivative of a law of a reading by the reading.
    """

    name: Hashable
    vector: Float64
    lines: tuple[Complex128, ...]
    wide: Callable[[int], Complex128]
    low: float = -np.inf
    high: float = np.inf
    damps: int = -1
    reads: int = -1
    scales: int = -1
    stretch: float = 0.0


@dataclass(frozen=True, eq=False)
class Numbers:
    """What a fit moves: plant, timing of the torque, strengths (P, 2) [(N·m)² on a line]."""

    plant: Plant
    timing: Timing
    strength: Float64

    @property
    def x(self) -> Float64:
        """(p,) plant, then timing."""
        return np.concatenate((self.plant.x, self.timing.x))

    def moved(self, x: Float64) -> Numbers:
        """The same with other numbers (p,)."""
        size = self.plant.x.size
        return replace(self, plant=self.plant.moved(x[:size]), timing=self.timing.moved(x[size:]))


@dataclass(frozen=True, eq=False)
class Problem:
    """Records, laws and the weak prior of the numbers: what a value is of."""

    stacks: tuple[Stack, ...]
    columns: tuple[Column, ...]
    spots: Spots
    centre: Float64
    spread: Float64
    corner: float
    least: float
    """Least strength [(N·m)²]."""
    swing: Float64
    """(2,) deviations of any coordinate's velocity and position from a record's start to its end."""
    shut: Int64 = field(default_factory=lambda: np.zeros(0, dtype=int))
    """Places whose strength stays as it is."""

    @classmethod
    def about(cls, stacks: tuple[Stack, ...], columns: tuple[Column, ...], numbers: Numbers) -> Problem:
        """The problem whose prior lies about ``numbers``."""
        structure, timing = numbers.plant.structure, numbers.timing
        top = max(r.top_hz for s in stacks for r in s.records)
        return cls(
            stacks,
            columns,
            Spots.of(structure),
            np.concatenate((numbers.plant.x, timing.expected)),
            np.concatenate((structure.prior, timing.prior)),
            2 * np.pi * CORNER * top,
            LEAST * float(np.mean([s.torque_noise.mean() for s in stacks])),
            LARGE * np.max([s.swing for s in stacks], axis=0),
        )

    @cached_property
    def bounds(self) -> tuple[Float64, Float64]:
        """(J,) bounds of the coefficients."""
        return np.array([c.low for c in self.columns]), np.array([c.high for c in self.columns])

    @cached_property
    def vectors(self) -> Float64:
        """(n, J) places of the laws."""
        n = self.spots.vectors.shape[0]
        return np.array([c.vector for c in self.columns]).T if self.columns else np.zeros((n, 0))


LARGE = 3.0
"""Deviation of a coordinate's motion over that of the motor that moves most: loads swing further."""


def swings(problem: Problem, stack: Stack, stretch: Float64) -> Float64:
    """(2,) deviations of velocity and position over a record, over 2/T as its ends are; a reading that is
    stretched (M,) stretches what it says of them."""
    return float(stretch.mean()) * 2.0 / stack.span * problem.swing


NEARLY_SINGULAR = 1e-12
"""Diagonal beside normal equations of unit diagonal, for laws that the records cannot tell apart."""


@dataclass(frozen=True, eq=False)
class Ends:
    """What the ends of any record of a stack, which nobody knows, take out of its whitened rows.

    Of jumps of velocity and position with deviations of their own the ends are M·Δq̇ + C·Δq and M·Δq (``root``
    times numbers of deviation one). With A (2FM, 2n) the rows of those, A = U·S·Vᵀ, rows keep 1 − U·S²/(1 +
    S²)·Uᵀ of their square, and the value has ln|1 + AᵀA| beside. Attributes: ``columns`` (2FM, 2n) rows for
    ends of one, ``root`` (2n, 2n), ``basis`` U, ``sizes`` S, ``turned`` V.
    """

    columns: Float64
    root: Float64
    basis: Float64
    sizes: Float64
    turned: Float64

    @classmethod
    def of(cls, columns: Float64, root: Float64) -> Ends:
        """Of rows (2FM, 2n) for ends of one, and a root (2n, 2n) of their prior covariance."""
        basis, triangle = np.linalg.qr(columns @ root)
        left, sizes, right = np.linalg.svd(triangle)
        return cls(columns, root, basis @ left, sizes, right.T)

    def out_of(self, rows: Float64) -> Float64:
        """(…, 2FM, k) rows whose squares are those that are left of ``rows``."""
        kept = 1.0 / np.sqrt(1.0 + self.sizes**2)
        out: Float64 = rows - self.basis @ ((1.0 - kept)[:, None] * (self.basis.T @ rows))
        return out

    def numbers(self, rows: Float64) -> Float64:
        """(…, 2n, k) the ends that rows (…, 2FM, k) of missing torque ask for, in deviations."""
        shrunk = self.turned * (self.sizes / (1.0 + self.sizes**2))
        out: Float64 = -shrunk @ (self.basis.T @ rows)
        return out

    def steepness(self, rows: Float64, left: Float64) -> Float64:
        """(2n, 2n) half the change of the value by the root, at rows (R, 2FM) of which the ends are out and
        at what is ``left`` of them, with the ends in it."""
        whole = 1.0 + self.sizes**2
        numbers = -(rows @ self.basis) * (self.sizes / np.sqrt(whole)) @ self.turned.T
        told = self.columns.T @ self.basis * (self.sizes / whole) @ self.turned.T
        out: Float64 = rows.shape[0] * told + (left @ self.columns).T @ numbers
        return out

    @cached_property
    def covariance(self) -> Float64:
        """(2n, 2n) that is left of them."""
        left = self.root @ self.turned / np.sqrt(1.0 + self.sizes**2)
        return left @ left.T

    @cached_property
    def log_determinant(self) -> float:
        """ln|1 + AᵀA|."""
        return float(np.log1p(self.sizes**2).sum())


@dataclass(frozen=True, eq=False)
class StackWork:
    """One stack at given numbers: whitened rows with the ends taken out."""

    stack: Stack
    condensed: Condensed
    noise: MissingNoise
    position_noise: Float64
    """(M,) of the motion: that of the reading, stretched as the reading is."""
    torque_noise: Float64
    """(M,) of the torque that acts: that of the recorded one, scaled as it is."""
    whitener: Complex128
    """(F, M, M) with the lines' weights: rows of unit variance."""
    ends: Ends
    laws: Float64
    """(R, 2FM, J) whitened laws without the ends' share."""
    missing: Float64
    """(R, 2FM) whitened missing torque of the plant alone, the same way."""
    law_ends: Float64
    """(R, 2n, J + 1) ends that laws and missing torque ask for."""

    @property
    def turning(self) -> Float64:
        """(F,) weights of the loop's term: none for the mean, at which a free machine has no stiffness."""
        return np.where(self.stack.omega > 0.0, self.stack.weight, 0.0)

    def left(self, rows: Float64) -> Float64:
        """(R, 2FM) whitened missing torque with the ends in it, of ``rows`` with the laws."""
        return self.ends.out_of(rows[..., None])[..., 0]

    def on_lines(self, rows: Float64) -> Complex128:
        """(R, F, M) of rows (R, 2FM)."""
        real, imaginary = np.split(rows, 2, axis=1)
        return (real + 1j * imaginary).reshape(self.shape)

    @property
    def shape(self) -> tuple[int, int, int]:
        """R, F, M."""
        count, lines, motors = self.stack.position.shape
        return count, lines, motors


@dataclass(frozen=True, eq=False)
class Value:
    """−2 ln L at some numbers, with the coefficients (J,) that minimise it.

    ``share`` (records,) is each record's part of it, ``free`` (J,) which coefficients are within their
    bounds.
    """

    numbers: Numbers
    coefficients: Float64
    free: Bool
    share: Float64
    prior: float
    work: tuple[StackWork, ...]

    @property
    def total(self) -> float:
        """−2 ln L with the prior."""
        return float(self.share.sum()) + self.prior


def evaluate(problem: Problem, numbers: Numbers, coefficients: Float64 | None = None) -> Value:
    """−2 ln L at ``numbers``, the coefficients and ends profiled out; of kept-out records with
    ``coefficients`` (J,) as they were fitted.

    Raises
    ------
    LinAlgError
        The numbers are so far off that a covariance is not positive.
    """
    if coefficients is None:
        ones = np.ones(problem.stacks[0].position.shape[2])
        work = _works(problem, numbers, (ones, ones))
        coefficients, free = _coefficients(problem, work)
        scales = _sensor_scales(problem, coefficients)
        if any((s != ones).any() for s in scales):
            # A sensor that is scaled scales its noise: else a smaller plant had less of it.
            work = _works(problem, numbers, scales)
            coefficients, free = _coefficients(problem, work)
    else:
        work = _works(problem, numbers, _sensor_scales(problem, coefficients))
        free = np.zeros(coefficients.size, dtype=bool)
    share = [
        part for w in work for part in _shares(problem, w, w.missing + w.laws @ coefficients, coefficients)
    ]
    off = (numbers.x - problem.centre) / problem.spread
    return Value(numbers, coefficients, free, np.array(share), float(off @ off), work)


Scales = tuple[Float64, Float64]
"""(M,) motion over its reading, and torque over that recorded."""


def _sensor_scales(problem: Problem, coefficients: Float64) -> Scales:
    return reading_stretch(problem, coefficients), torque_scales(problem, coefficients)


def _works(problem: Problem, numbers: Numbers, scales: Scales) -> tuple[StackWork, ...]:
    return tuple(_work(problem, numbers, k, scales) for k in range(len(problem.stacks)))


def _work(problem: Problem, numbers: Numbers, number: int, scales: Scales) -> StackWork:
    stack = problem.stacks[number]
    omega = stack.omega
    position_noise, torque_noise = stack.position_noise * scales[0] ** 2, stack.torque_noise * scales[1] ** 2
    condensed = numbers.plant.condense(omega)
    stiffness, motion = condensed.stiffness, condensed.motion
    noise = missing_noise(
        stiffness,
        along(motion, problem.spots.vectors),
        colours(omega, problem.corner) @ numbers.strength.T,
        (position_noise, torque_noise),
    )
    whitener = noise.whitener * np.sqrt(2.0 * stack.weight)[:, None, None]
    columns = real_rows((whitener @ condensed.jumps(omega))[None])[0]
    _, damping, inertia = numbers.plant.matrices
    fast, far = swings(problem, stack, scales[0])
    root = np.block([[fast * inertia, far * damping], [np.zeros_like(inertia), far * inertia]])
    ends = Ends.of(columns, root)
    acting = numbers.timing.acting(stack)
    missing = (stiffness @ stack.position[..., None])[..., 0] - acting
    both = np.concatenate(
        (_law_columns(problem, number, (whitener, condensed, acting)), (whitener @ missing[..., None])),
        axis=3,
    )
    whole = real_rows(both)
    rows = ends.out_of(whole)
    law_rows, missing_rows = rows[..., :-1], rows[..., -1]
    return StackWork(
        stack,
        condensed,
        noise,
        position_noise,
        torque_noise,
        whitener,
        ends,
        law_rows,
        missing_rows,
        ends.numbers(whole),
    )


def _law_columns(problem: Problem, number: int, at: tuple[Complex128, Condensed, Complex128]) -> Complex128:
    """(R, F, M, J) whitened laws; ``at``: whitener, plant and the torque that acts."""
    stack = problem.stacks[number]
    whitener, condensed, acting = at
    reach = whitener @ along(condensed.motion, problem.vectors)
    out = np.empty((*stack.position.shape, len(problem.columns)), dtype=complex)
    for j, column in enumerate(problem.columns):
        if column.scales >= 0:
            out[..., j] = -acting[:, :, column.scales, None] * whitener[:, :, column.scales]
        elif column.reads >= 0:
            read = (whitener @ condensed.stiffness[:, :, column.reads, None])[..., 0]
            out[..., j] = column.lines[number][:, :, None] * read
        else:
            out[..., j] = column.lines[number][:, :, None] * reach[:, :, j]
    return out


def along(values: Complex128, vectors: Float64) -> Complex128:
    """(…, k) of (…, n) along vectors (n, k), as one product."""
    flat = values.reshape(-1, values.shape[-1])
    out: Complex128 = (flat @ vectors.astype(complex)).reshape(*values.shape[:-1], vectors.shape[1])
    return out


def real_rows(values: Complex128) -> Float64:
    """(R, 2FM, k) real and imaginary parts of (R, F, M, k)."""
    flat = values.reshape(values.shape[0], -1, values.shape[-1])
    return np.concatenate((flat.real, flat.imag), axis=1)


def _coefficients(problem: Problem, work: tuple[StackWork, ...]) -> tuple[Float64, Bool]:
    """(J,) coefficients that minimise the sum of squares within their bounds, and which are free."""
    count = len(problem.columns)
    normal, right = np.zeros((count, count)), np.zeros(count)
    for w in work:
        flat = w.laws.reshape(-1, count)
        normal += flat.T @ flat
        right += flat.T @ w.missing.ravel()
    found, free = bounded_minimum(normal, right, problem.bounds)
    if not np.isfinite(found).all():
        raise np.linalg.LinAlgError("no coefficients of the laws are finite")
    return found, free


def bounded_minimum(normal: Float64, right: Float64, bounds: tuple[Float64, Float64]) -> tuple[Float64, Bool]:
    """(J,) minimum of xᵀ·normal·x + 2·right·x within bounds (J,) low and high, and which x are free.

    Block principal pivoting (Júdice and Pires 1994): all that violate a bound go there and all that are
    pulled off theirs go free at once; one at a time where that no longer lowers their number.
    """
    size = np.sqrt(np.diag(normal)) + 1e-300
    scaled = normal / size[:, None] / size + NEARLY_SINGULAR * np.eye(size.size)
    pull = right / size
    low, high = bounds[0] * size, bounds[1] * size
    side = np.zeros(size.size)
    x, fewest, blocks = np.zeros(size.size), size.size + 1, PIVOTS
    for _ in range(PIVOTS * (size.size + 1)):
        free = side == 0.0
        x = np.where(side < 0.0, low, high)
        x[free] = 0.0
        force = scaled @ x + pull
        x[free] = np.linalg.solve(scaled[np.ix_(free, free)], -force[free])
        force[~free] += scaled[np.ix_(~free, free)] @ x[free]
        beyond = np.where(x < low, -1.0, np.where(x > high, 1.0, 0.0)) * free
        eased = ~free & (force * side > ROUNDED * np.abs(pull)) & (low < high)
        wrong = np.flatnonzero((beyond != 0.0) | eased)
        if not wrong.size:
            break
        blocks = PIVOTS if wrong.size < fewest else blocks - 1
        fewest = min(fewest, wrong.size)
        moved = wrong if blocks > 0 else wrong[-1:]
        side[moved] = beyond[moved]
    return np.clip(x, low, high) / size, side == 0.0


PIVOTS = 3
"""Blocks that may not lower the number of violations before single ones are exchanged (Júdice and Pires)."""
ROUNDED = 1e-12
"""Share of its pull by which a number at a bound may be pulled off it (numerical)."""


def _shares(problem: Problem, work: StackWork, rows: Float64, coefficients: Float64) -> Float64:
    """(R,) each record's part of −2 ln L."""
    weight = work.stack.weight
    loop = closed_loop(problem, work, coefficients)
    closed = 4.0 * (work.turning * np.linalg.slogdet(loop)[1]).sum(axis=1) if loop.size else 0.0
    out: Float64 = (rows**2).sum(axis=1) + 2.0 * float(weight @ work.noise.log_determinant)
    out += work.ends.log_determinant
    out[work.stack.closed] -= closed
    # Where a hold is not known the torque is what answers: its Jacobian is the drives' scale.
    scale = float(np.log(torque_scales(problem, coefficients)).sum())
    out[~work.stack.closed] -= 4.0 * float(work.turning.sum()) * scale
    return out


def torque_scales(problem: Problem, coefficients: Float64) -> Float64:
    """(M,) torque that acts over that recorded, of laws that multiply it."""
    out = np.ones(problem.stacks[0].position.shape[2])
    for column, value in zip(problem.columns, coefficients, strict=True):
        if column.scales >= 0:
            out[column.scales] += value
    return out


def reading_stretch(problem: Problem, coefficients: Float64) -> Float64:
    """(M,) motion of the motors over that of their readings, to first order."""
    out = np.ones(problem.stacks[0].position.shape[2])
    for column, value in zip(problem.columns, coefficients, strict=True):
        if column.reads >= 0:
            out[column.reads] += value * column.stretch
    return out


def closed_loop(problem: Problem, work: StackWork, coefficients: Float64) -> Complex128:
    """(C, F, M, M) Z + L of the records whose holds are known."""
    stack = work.stack
    damping = np.zeros(stack.position.shape[2])
    for column, value in zip(problem.columns, coefficients, strict=True):
        if column.damps >= 0:
            damping[column.damps] += value
    scale = torque_scales(problem, coefficients)
    added = stack.loop[stack.closed] * scale + 1j * stack.omega[:, None] * damping
    stiffness = work.condensed.stiffness * reading_stretch(problem, coefficients)
    out: Complex128 = stiffness + added[..., None] * np.eye(damping.size)
    out[:, stack.omega == 0.0] = np.eye(damping.size)
    return out


def missing_torque(value: Value, number: int) -> Complex128:
    """(R, F, M) missing torque with laws and ends in it."""
    work = value.work[number]
    white = work.on_lines(work.left(work.missing + work.laws @ value.coefficients))
    return np.asarray((np.linalg.inv(work.whitener) @ white[..., None])[..., 0], dtype=np.complex128)
