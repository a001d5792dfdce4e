"""When a motor reverses and when it stands, from position and torque together.

Below some 20 Hz the encoder determines the velocity, above it the torque does, through the motor's inertia.
With the position alone the instants of slow reversals were off by milliseconds (18 bits, 1 kHz): Coulomb
friction came out 1.5 % too large, viscous friction negative by two to four of its standard deviations, motor
masses one of theirs too small (``bench_identify.py --case friction``). The fusion is that of the fit, the
projected position Θ̂ = Θ − C_Θr C_r⁻¹ r, on every line of the record.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.likelihood.covariance import parameter_std
from invid.likelihood.excess_variance import SIGNIFICANT, WINDOW
from invid.likelihood.levenberg_marquardt import Solution, gauss_newton
from invid.likelihood.nuisance.friction_columns import sign_spectrum, velocity_signs
from invid.likelihood.nuisance.torque_channel import Block, channel_torque
from invid.likelihood.nuisance.torque_lags import COULOMB, COULOMB_SIGMA, LAG_FACTOR, NOISE_LIKE
from invid.likelihood.records import add_columns, used_lines
from invid.likelihood.residual import MissingTorqueProblem, condense_dense
from invid.model.transient_terms import end_columns, end_forces, end_points
from invid.numerics import budget
from invid.numerics.arrays import Bool, Complex128, Float64
from invid.signals.spectra import LineSpectra

LINES_AT_ONCE = 2048
"""Lines condensed at once, which bounds the memory of long records."""
MOST_FITS = 5
"""Most fits with new reversals (empirical: two where motors hardly stand)."""
ROUNDS = 3
"""Rounds in which reversals and velocity are computed from each other (empirical, virtual cells: more change
nothing)."""
SIGN_SIGMA = 4.0
"""Standard deviations of the velocity within which its sign is not known (statistical: wrong once in 30
000)."""


def fit_sharp_reversals(
    problem: MissingTorqueProblem, solution: Solution, spectra: Sequence[LineSpectra]
) -> tuple[MissingTorqueProblem, Solution]:
    """Problem and solution with friction that reverses where position and torque together say.

    Reversals and fit alternate, from reversals of the position alone, as long as χ² falls by a hundredth.
    """
    places = [
        (k, problem.structure.axes.index(n.removesuffix(COULOMB)))
        for k, n in enumerate(problem.column_names)
        if n.endswith(COULOMB)
    ]
    plain = problem, solution
    guesses = [velocity_signs(s) for s in spectra]
    signs = [sign for sign, _ in guesses]
    for _ in range(MOST_FITS):
        if budget.is_spent():
            break
        size = np.zeros(problem.structure.motors)
        first, spread = problem.slices["column"].start, parameter_std(solution)
        for k, i in places:
            # Friction that is not significant will leave the fit.
            if solution.p[first + k] > COULOMB_SIGMA * spread[first + k]:
                size[i] = float(solution.p[first + k])
        if not np.any(size):
            break
        values = problem.structure.physical(solution.p[: problem.structure.count])
        inertia = values[list(problem.structure.motor_dofs)]
        columns = []
        plants: dict[bytes, tuple[Complex128, Complex128]] = {}
        for number, (s, state) in enumerate(zip(spectra, problem.states(solution.p), strict=True)):
            moves = guesses[number][1]
            whole = whole_block(state.block, s)
            key = whole.omega.tobytes()
            if key not in plants:
                plants = {key: _condense_lines(problem, solution.p, whole.omega)}
            found = fuse_record(problem, solution.p, whole, state.ends, *plants[key])
            periodic = not s.transient or s.periods > 1
            signs[number] = reversal_signs(found, s, signs[number], size * moves, inertia, periodic=periodic)
            spectrum = sign_spectrum(s, signs[number])[used_lines(s, everything=state.block.transient)]
            part = state.block.columns.copy()
            for k, i in places:
                if moves[i] and size[i] > 0:
                    part[:, i, k] = spectrum[:, i]
            columns.append(part)
        refined = add_columns(problem, columns, problem.column_names)
        refitted = gauss_newton(refined, solution.p)
        before = solution.chi2
        if refitted.chi2 < before:
            problem, solution = refined, refitted
        if refitted.chi2 > 0.99 * before:
            break
    # As for lags of torque channels: unmodelled effects make any further parameter a little better.
    if solution.reduced > NOISE_LIKE and plain[1].chi2 < LAG_FACTOR * solution.chi2:
        return plain
    return problem, solution


@dataclass(frozen=True, eq=False)
class FusedRecord:
    """A record on all its lines without Coulomb friction.

    ``missing`` (L, M) is the missing torque without it, ``stiffness`` (L, M, M) Z, ``noise`` (L, M) the noise
    power of the positions and ``other`` (L, M) that of the torques.
    """

    omega: Float64
    missing: Complex128
    stiffness: Complex128
    noise: Float64
    other: Float64


def fuse_record(
    problem: MissingTorqueProblem,
    p: Float64,
    whole: Block,
    ends: Float64,
    motion: Complex128,
    stiffness: Complex128,
) -> FusedRecord:
    """A record, as the block ``whole`` of all its lines, under parameters ``p`` (n,) and boundary terms
    ``ends``.

    W and Z are ``motion`` (L, ΣN, M) and ``stiffness`` (L, M, M).
    """
    structure = problem.structure
    motors, lines = structure.motors, whole.omega.size
    sp = p[problem.slices["structure"]]
    channel = channel_torque(whole, p[problem.slices["delay"]], p[problem.slices["staircase"]])
    effective = stiffness.copy()
    effective[:, np.arange(motors), np.arange(motors)] -= channel.hold
    missing = np.einsum("fij,fj->fi", effective, whole.position) - channel.factor * whole.torque
    missing -= np.einsum("fij,fj->fi", stiffness, channel.folded @ structure.inertance(sp))
    for low in range(0, lines if whole.transient else 0, LINES_AT_ONCE):
        part = slice(low, min(low + LINES_AT_ONCE, lines))
        forces = end_forces(structure, sp, whole.omega[part], whole.span)
        points = end_points(whole.omega[part], whole.step, whole.span, ends_in=whole.ends_in)
        missing[part] += end_columns(structure, motion[part], effective[part], forces, points) @ ends
    other = whole.noise[:, motors:] * np.abs(channel.factor) ** 2
    return FusedRecord(whole.omega, missing, effective, whole.noise[:, :motors], other)


def _condense_lines(
    problem: MissingTorqueProblem, p: Float64, omega: Float64
) -> tuple[Complex128, Complex128]:
    """W (L, ΣN, M) and Z (L, M, M) of all lines, computed in parts."""
    parts = [
        condense_dense(problem.structure, p[problem.slices["structure"]], omega[low : low + LINES_AT_ONCE])[
            :2
        ]
        for low in range(0, omega.size, LINES_AT_ONCE)
    ]
    return np.concatenate([w for w, _ in parts]), np.concatenate([z for _, z in parts])


def reversal_signs(
    found: FusedRecord,
    s: LineSpectra,
    sign: Float64,
    friction: Float64,
    inertia: Float64,
    *,
    periodic: bool,
) -> Float64:
    """(n, M) Coulomb friction over its size around each sample: the velocity's sign where a motor moves.

    ``sign`` is a first guess. ``friction`` (M,) is the size of the friction, zero for a motor that has none
    or does not move (its column is returned unchanged), ``inertia`` (M,) that of the motors.
    """
    wave = np.asarray(s.position_wave)
    count, motors = wave.shape
    step = 1.0 / s.sample_rate_hz
    ramp = np.zeros(motors)
    if not periodic:
        ramp = (wave[-1] - wave[0]) / ((count - 1) * step)
        wave = wave - np.arange(count)[:, None] * step * ramp
    spectrum = np.fft.rfft(wave, axis=0)
    lines = slice(1, found.omega.size + 1)
    rate = np.zeros((spectrum.shape[0], 1), dtype=complex)
    rate[lines, 0] = 1j * found.omega
    floor = (found.stiffness * found.noise[:, None, :]) @ found.stiffness.conj().transpose(0, 2, 1)
    held = sign.copy()
    diagonal = np.arange(motors)
    floor[:, diagonal, diagonal] += found.other
    for _ in range(ROUNDS):
        friction_lines = np.fft.rfft(sign, axis=0)[lines] * (2.0 / count) * friction
        missing = found.missing + friction_lines
        total = floor[:, diagonal, diagonal].real
        covariance = floor.copy()
        covariance[:, diagonal, diagonal] += _excess_power(missing, total, total < 2.0 * found.other)
        noise_gain = found.stiffness * found.noise[:, None, :]  # C_rΘ
        gain = np.linalg.solve(covariance, np.concatenate((missing[..., None], noise_gain), axis=2))
        back = noise_gain.conj().transpose(0, 2, 1)
        moved = (back @ gain[..., :1])[..., 0]
        left = found.noise - np.einsum("fij,fji->fi", back, gain[..., 1:]).real
        corrected = spectrum.copy()
        corrected[lines] -= moved * (count / 2.0)
        velocity = np.fft.irfft(rate * corrected, count, axis=0) + ramp
        spread = np.sqrt(np.maximum((found.omega[:, None] ** 2 * left).sum(axis=0) / 2.0, 0.0))
        for i in np.flatnonzero(friction > 0):
            slow, slowed = SIGN_SIGMA * spread[i], friction[i] / inertia[i] * step
            held[:, i] = interval_means(velocity[:, i], held[:, i], slow, slowed, periodic=periodic)
        # An interval's friction acts half a sample after the instant it begins.
        first = held[-1:] if periodic else held[:1]
        sign = 0.5 * (held + np.concatenate((first, held[:-1])))
    return sign


def interval_means(
    velocity: Float64, before: Float64, slow: float, slowed: float, *, periodic: bool = False
) -> Float64:
    """(n,) mean friction over its size in the interval after each sample.

    Where the velocity is within ``slow`` of zero or changes its sign, the motor is simulated from sample to
    sample: friction balances the other forces on a standing motor until they exceed it.

    Parameters
    ----------
    velocity
        (n,) [rad/s].
    before
        (n,) friction over its size with which ``velocity`` was found.
    slow
        Velocity [rad/s] below which its sign is not known.
    slowed
        Velocity [rad/s] by which friction slows the motor in one sample: the unit of everything below.
    """
    now = velocity / slowed
    after = np.append(now[1:], now[0] if periodic else now[-1])
    pull = after - now + before  # all forces but friction
    out: Float64 = np.sign(now)
    speed, last = 0.0, -2
    for k in np.flatnonzero((np.abs(velocity) < slow) | (now * after <= 0)):
        if k != last + 1 or abs(velocity[k]) >= slow:
            speed = float(now[k])
        force, way = float(pull[k]), float(np.sign(speed))
        rest = min(max(force, -1.0), 1.0)  # friction once the motor has come to stand
        moving = 0.0  # share of the interval until it does
        if way != 0.0:
            rate = force - way
            moving = min(-speed / rate, 1.0) if way * rate < 0 else 1.0
        out[k] = way * moving + rest * (1.0 - moving)
        stands = moving < 1.0 and abs(force) <= 1.0
        speed = 0.0 if stands else speed + force - float(out[k])
        last = int(k)
    return out


def _excess_power(missing: Complex128, floor: Float64, is_told: Bool) -> Float64:
    """(L, M) power of torques that the model lacks: significant missing torque beyond its noise.

    Only the lines ``is_told`` (L, M), where the position has less noise than the torque, determine it: near
    the Nyquist frequency the ends of a record look alike. Above them the value of the last of them is used.
    """
    power = np.abs(missing) ** 2 - floor
    lines, motors = power.shape
    sums = np.cumsum(np.hstack((power, floor**2)), axis=0)
    sums = np.concatenate((np.zeros((1, 2 * motors)), sums))
    low = np.maximum(np.arange(lines) - WINDOW // 2, 0)
    high = np.minimum(low + WINDOW, lines)
    count = (high - low)[:, None]
    excess, square = np.split((sums[high] - sums[low]) / count, 2, axis=1)
    out = np.where(is_told & (excess > SIGNIFICANT * np.sqrt(square / count)), excess, 0.0)
    for i in range(motors):
        last = int(np.flatnonzero(is_told[:, i])[-1]) if is_told[:, i].any() else 0
        out[last:, i] = out[max(last - WINDOW // 2, 0), i]
    return out


def whole_block(block: Block, s: LineSpectra) -> Block:
    """The block on every line below the Nyquist frequency."""
    count, motors = s.position_wave.shape
    lines = np.arange(1, (count - 1) // 2 + 1)
    omega = 2 * np.pi * lines * s.sample_rate_hz / count
    first = round(float(s.frequency_hz[0]) * count / s.sample_rate_hz)

    def amplitudes(wave: Float64, known: Complex128) -> Complex128:
        spectrum = np.fft.rfft(wave, axis=0)[lines] * (2.0 / count)
        # The end-point correction is the same on every line.
        result: Complex128 = spectrum + (known[0] - spectrum[first - 1])
        return result

    law = block.hold[:1].real + 1j * omega[:, None] * block.hold[:1].imag / block.omega[0]
    return replace(
        block,
        omega=omega,
        position=amplitudes(s.position_wave, s.position),
        torque=amplitudes(s.torque_wave, s.torque),
        noise=np.broadcast_to(s.floor, (lines.size, 2 * motors)),
        hold=law,
        columns=np.zeros((lines.size, motors, 0), dtype=complex),
        stepped=None,
    )
