"""A rational FRF matrix straight from records that are not settled, or whose lines interleave.

Vector fitting with the records themselves as data: σ(ω)·A_ie = Σ_j N_ij(ω)·T_je + B_ie(ω), with A the
acceleration spectra of experiment e, common poles in σ, N and B, and B what leaks from the ends of the
record: the transient of the same plant, so it has the same poles and a first-degree polynomial beside
them. Linear in everything once the poles are given, which are relocated a few times (Gustavsen and
Semlyen 1999; the transient as further numerator: Pintelon and Schoukens, System Identification, ch. 6).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.modes.model import Modes, high_gain_pairs, pairs
from invid.numerics.arrays import Bool, Complex128, Float64
from invid.numerics.linear_algebra import eigenvalues, least_squares, real_rows
from invid.signals.spectra import FEW_LINES, LineSpectra

TRUSTED = 0.02
"""Relative error granted to every spectrum: records with friction must not be fitted to their noise."""
LEAST_DAMPING = 1e-9
"""Of a pole between rounds; finer than any band of lines can tell from none."""
DAMPING = 0.01
SPLIT = 1e-9
"""Relative distance of starting resonances (numerical)."""
MOST_LINES = 300


def even_poles(low: float, high: float, count: int, scale: float) -> Complex128:
    """(count,) lightly damped poles evenly between two frequencies [rad/s], over ``scale``."""
    poles: Complex128 = np.linspace(low, high, count + 2)[1:-1] / scale * np.complex128(-DAMPING + 1j)
    return poles


def modes_of(
    poles: Complex128, residues: Float64, scale: float, masses: tuple[int, ...], *, shared: bool = False
) -> Modes:
    """Mass-normalised motor shapes from the residues of the acceleration.

    Near a pole −ω²G ≈ c/(jω − p) with c real coefficients a + jb of the basis; the receptance has the
    residue c/p², and φφᵀ = Re(2j·ω_d·c/p²), of which the leading eigenvector is kept. Where branches are
    equal (``shared``) modes share poles, and of the eigenvectors of all poles those are kept that swing most.
    """
    count, motors = poles.size, len(masses)
    omega = np.abs(poles)
    damping = np.clip(-poles.real / omega, 1e-4, 0.3)
    strength = np.zeros((count, motors))
    every = np.zeros((count, motors, motors))
    for r in range(count):
        c = (residues[r] + 1j * residues[count + r]) * scale
        product = (2j * poles[r].imag * c / poles[r] ** 2).real
        size, vectors = np.linalg.eigh(0.5 * (product + product.T))
        every[r] = (np.sqrt(np.maximum(size, 0.0)) * vectors).T
        strength[r] = np.maximum(size, 0.0) ** 2 / (damping[r] * omega[r] ** 3)
    if not shared:
        strength[:, :-1] = -1.0
    at, own = np.unravel_index(
        np.sort(np.argsort(strength, axis=None)[strength.size - count :]), strength.shape
    )
    # Modes that share a pole must not start at exactly one point.
    omega, damping, shapes = omega[at] * (1.0 + SPLIT * np.arange(count)), damping[at], every[at, own]
    high = residues[2 * count]
    rows, columns = pairs(motors)
    allowed = high_gain_pairs(masses)
    gain = np.zeros((motors, motors))
    keep = (rows[allowed], columns[allowed])
    gain[keep] = high[keep]
    gain[keep[1], keep[0]] = high[keep]
    order = np.argsort(omega)
    unknowns = 2 * count + 2 * count * motors + 2 * rows.size
    return Modes(
        omega=omega[order],
        damping=damping[order],
        shapes=shapes[order],
        high_gain=gain,
        friction=np.zeros((motors, motors)),
        masses=masses,
        covariance=np.zeros((unknowns, unknowns)),
        model_error=TRUSTED,
    )


Record = tuple[Float64, Complex128, Complex128, Float64, bool]


def record_of(s: LineSpectra, trusted: float) -> Record:
    """ω, acceleration, torque, weight of one record on the lines that carry something."""
    lines: Bool = np.array(s.excited)
    transient = s.transient
    if transient and lines.any():
        upto = np.arange(lines.size) <= np.flatnonzero(lines)[-1]
        if upto.sum() < FEW_LINES:
            # A sine that still settles: too few lines for an end of its own, but a start may be crude.
            power = (np.abs(s.torque) ** 2).sum(axis=1)
            lines, transient = power > 0.1 * power.max(), False
        else:
            lines = upto
    index, most = np.flatnonzero(lines), MOST_LINES
    if index.size > most:
        # Excited lines first, then an even choice of the others.
        rest = index[~s.excited[index]]
        main = index[s.excited[index]]
        main = main[np.linspace(0, main.size - 1, min(main.size, most)).astype(int)] if main.size else main
        room = max(most - main.size, most // 3)
        rest = rest[np.linspace(0, rest.size - 1, min(rest.size, room)).astype(int)] if rest.size else rest
        index = np.union1d(main, rest)
    w = s.omega[index]
    # A quarter of a sample: between a torque that is continuous and one held over the sample.
    torque = s.torque[index] * np.exp(-0.25j * w / s.sample_rate_hz)[:, None]
    acceleration = -(w**2)[:, None] * s.position[index]
    noise = (w**2)[:, None] * np.sqrt(s.floor[: s.axis_count])
    level = np.sqrt(np.mean(np.abs(acceleration) ** 2, axis=0))
    weight = 1.0 / np.sqrt(
        noise**2 + (trusted * np.abs(acceleration)) ** 2 + (0.05 * trusted * level) ** 2 + 1e-300
    )
    return w, acceleration, torque, weight, transient


def fractions(w: Float64, poles: Complex128) -> Complex128:
    """(F, 2n+1) real-coefficient partial fractions and a constant."""
    s = 1j * w[:, None]
    up, down = 1.0 / (s - poles), 1.0 / (s - poles.conj())
    out: Complex128 = np.concatenate((up + down, 1j * (up - down), np.ones((w.size, 1))), axis=1)
    return out


def columns_of(data: Sequence[Record], poles: Complex128, motors: int, scale: float) -> list[Complex128]:
    """Per record (F, M·(2n+1) + own transient) columns; transients of other records are left out."""
    out = []
    for w, _, torque, _, transient in data:
        basis = fractions(w / scale, poles)
        parts = [torque[:, j : j + 1] * basis for j in range(motors)]
        if transient:
            parts.append(np.concatenate((basis, 1j * w[:, None] / scale), axis=1))
        out.append(np.concatenate(parts, axis=1))
    return out


def project_out_transients(
    data: Sequence[Record],
    columns: Sequence[Complex128],
    right: Sequence[Complex128],
    motor: int,
    shared: int,
) -> tuple[Float64, Float64]:
    """Rows with every record's transient projected out: (rows, shared) and (rows, right columns)."""
    lefts, rights = [], []
    for (_, _, _, weight, _), matrix, target in zip(data, columns, right, strict=True):
        own = weight[:, motor : motor + 1]
        left = real_rows(own * matrix)
        goal = real_rows(own * target)
        if left.shape[1] > shared:
            size = np.linalg.norm(left[:, shared:], axis=0)
            q, _ = np.linalg.qr(left[:, shared:] / np.where(size > 0, size, 1.0))
            left = left[:, :shared] - q @ (q.T @ left[:, :shared])
            goal = goal - q @ (q.T @ goal)
        lefts.append(left[:, :shared])
        rights.append(goal)
    return np.concatenate(lefts), np.concatenate(rights)


def relocate_once(data: Sequence[Record], poles: Complex128, motors: int, scale: float) -> Complex128 | None:
    """Zeros of σ: the poles of the next round; ``None`` where the data leave no finite ones."""
    count = poles.size
    shared = motors * (2 * count + 1)
    columns = columns_of(data, poles, motors, scale)
    rows, emphasis = [], 0.0
    for i in range(motors):
        targets = [-(a[:, i : i + 1]) * fractions(w / scale, poles) for w, a, *_ in data]
        left, goal = project_out_transients(data, columns, targets, i, shared)
        size = np.linalg.norm(left, axis=0)
        left = left / np.where(size > 0, size, 1.0)
        triangle = np.asarray(np.linalg.qr(np.concatenate((left, goal), axis=1), mode="r"))
        rows.append(triangle[shared:, shared:])
        emphasis += float((goal[:, -1] ** 2).sum())
    matrix = np.concatenate(rows)
    # Relaxed: σ's mean over the lines is one.
    mean = np.mean(np.concatenate([fractions(w / scale, poles).real for w, *_ in data]), axis=0)
    matrix = np.concatenate((matrix, np.sqrt(emphasis) * mean[None]))
    right = np.zeros(matrix.shape[0])
    right[-1] = np.sqrt(emphasis)
    if not np.isfinite(np.linalg.norm(matrix, axis=0)).all():
        return None
    x = least_squares(matrix, right)
    direct = x[-1] if abs(x[-1]) > 1e-8 else 1e-8
    state = np.zeros((2 * count, 2 * count))
    first, second = np.arange(count), np.arange(count, 2 * count)
    state[first, first] = state[second, second] = poles.real
    state[first, second], state[second, first] = poles.imag, -poles.imag
    drive = np.concatenate((np.full(count, 2.0), np.zeros(count)))
    values = eigenvalues(state - np.outer(drive, x[:-1]) / direct)
    if values is None:
        return None
    # Never on the axis itself, where a line may stand.
    values = -np.maximum(np.abs(values.real), LEAST_DAMPING * np.abs(values.imag)) + 1j * values.imag
    upper = values[values.imag > 1e-9]
    low, top = min(w[0] for w, *_ in data) / scale, max(w[-1] for w, *_ in data) / scale
    missing = count - upper.size
    if missing > 0:
        # Two real poles describe no mode: a lightly damped pair somewhere in the widest gap instead.
        edges = np.sort(np.concatenate(([low], upper.imag, [top])))
        for _ in range(missing):
            at = int(np.argmax(np.diff(edges)))
            centre = 0.5 * (edges[at] + edges[at + 1])
            upper = np.append(upper, centre * (-DAMPING + 1j))
            edges = np.sort(np.append(edges, centre))
    ordered: Complex128 = upper[np.argsort(upper.imag)][:count]
    # Poles that ran away or hide as broad humps come back to the band, lightly damped.
    wild = (ordered.imag > 1.5 * top) | (np.abs(ordered.real) > 0.3 * ordered.imag)
    tamed: Complex128 = np.where(wild, np.minimum(ordered.imag, 1.2 * top) * (-0.05 + 1j), ordered)
    return tamed


def residues_of(data: Sequence[Record], poles: Complex128, motors: int, scale: float) -> Float64:
    """(2n+1, M, M) real coefficients of N with the poles given; reciprocity imposed by averaging."""
    shared = motors * (2 * poles.size + 1)
    columns = columns_of(data, poles, motors, scale)
    out = np.zeros((2 * poles.size + 1, motors, motors))
    for i in range(motors):
        left, goal = project_out_transients(data, columns, [a[:, i : i + 1] for _, a, *_ in data], i, shared)
        x = least_squares(left, goal[:, 0])
        out[:, i, :] = x.reshape(motors, -1).T
    return 0.5 * (out + out.transpose(0, 2, 1))
