"""``make_case(seed)``: a recording with a hidden effect, and what was hidden.

The diagnosis gets the recording alone. ``Truth.db`` is the size of the effect: the power, on all
lines of the excited band and averaged over the identify experiments, of the missing torque that
remains after a linear refit, over the power that sensor noise leaves in the same averaged spectra
(both whitened by the noise). It is computed here, from noise-free sub-step logs, with this folder's
own matrices.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hidden.causes import CATALOGUE, OUTSIDE, Cause, Scales, available
from hidden.integrator import integrate
from hidden.plants import Plant, assemble, flexible_modes, paper_plant, random_plant
from invid.chains import CoupledChains
from invid.recording.model import Experiment, Kind, Outcome, Recording, Role


@dataclass(frozen=True)
class TrueEffect:
    """One hidden effect; ``element`` is None where any (or no) element is right."""

    cause: str
    axis: str
    element: str | None
    other_axis: str | None
    parameters: dict[str, float]
    in_catalogue: bool


@dataclass(frozen=True, eq=False)
class Truth:
    """What was hidden and how large it is."""

    seed: int
    kind: str  # "null", "catalogue", "outside", "pair", "wrong_order"
    effects: tuple[TrueEffect, ...]
    chains: CoupledChains
    db: float
    settings: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Run:
    """One experiment to be simulated."""

    kind: Kind
    role: Role
    excited: int
    excitation: np.ndarray  # one period at sub-steps (P·sub, M), or the whole move
    reference: np.ndarray
    reference_rate: np.ndarray
    settle: int
    periods: int
    lines_hz: np.ndarray
    period: int  # samples; 0 for a move
    start_time: float
    length: int  # recorded samples


@dataclass(frozen=True, eq=False)
class Setup:
    """Plant, sensors, drives and plan: all but the effect."""

    plant: Plant
    rate: float
    sub: int
    kp: np.ndarray
    kd: np.ndarray
    hold_sampled: bool
    staircase: bool
    peak: np.ndarray
    torque_noise: np.ndarray
    position_noise: np.ndarray
    resolution: np.ndarray
    torque_step: np.ndarray
    rated: np.ndarray
    runs: tuple[Run, ...]
    settings: dict[str, Any]

    @property
    def h(self) -> float:
        return 1.0 / self.rate / self.sub


# --- excitation ------------------------------------------------------------------------------------
def _multisine(
    rng: np.random.Generator, lines: np.ndarray, hz: np.ndarray, samples: int, count: int
) -> np.ndarray:
    """Half spectra (count, lines) of random-phase multisines, peak 1, amplitude ∝ f^−½; best of 20."""
    out = []
    for _ in range(count):
        best, crest = None, np.inf
        for _ in range(20):
            half = hz**-0.5 * np.exp(2j * np.pi * rng.uniform(size=hz.size))
            spectrum = np.zeros(samples // 2 + 1, dtype=complex)
            spectrum[lines] = half
            wave = np.fft.irfft(spectrum, samples)
            if (now := np.abs(wave).max() / wave.std()) < crest:
                best, crest = half * (1.0 / np.abs(wave).max() / samples * 2), now
        out.append(best)
    return np.array(out)


def _wave(amplitudes: np.ndarray, lines: np.ndarray, samples: int) -> np.ndarray:
    """Time signal of complex amplitudes X (|X| is a sinusoid's amplitude), one period."""
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[lines] = amplitudes * samples / 2
    return np.fft.irfft(spectrum, samples)


def _move(
    axis: int, count: int, speed: float, travel: float, samples: int, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """There and back at constant speed, smooth turns: reference (samples, M) and its rate."""
    turn = max(int(0.15 * samples / 2), 1)
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.arange(turn) / turn)
    half = samples // 2
    one = np.concatenate([ramp, np.ones(half - 2 * turn), ramp[::-1]])
    rate_1d = np.concatenate([one, -one, np.zeros(samples - 2 * half)])
    rate_1d *= min(speed, travel / (one.sum() * h))
    rate = np.zeros((samples, count))
    if axis >= 0:
        rate[:, axis] = rate_1d
    else:
        rate[:] = rate_1d[:, None]
    return np.cumsum(rate, axis=0) * h, rate


def _setup(
    rng: np.random.Generator,
    plant: Plant,
    *,
    noise: float | None = None,
    bits: int | None = None,
    moves: bool | None = None,
    validate: bool = True,
    torque_quantised: bool | None = None,
    drive: str | None = None,
    periods: int | None = None,
) -> Setup:
    count = plant.count
    rate = float(rng.choice([250.0, 500.0, 1000.0], p=[0.3, 0.5, 0.2]))
    sub = {250.0: 20, 500.0: 10, 1000.0: 5}[rate]
    period = int(rate * rng.choice([8.0, 10.0]))
    drive = drive or str(rng.choice(["sampled", "smooth", "mixed"], p=[0.5, 0.35, 0.15]))
    top = 1.25 * flexible_modes(plant)[-1] / (2 * np.pi) if plant.mass.shape[0] > count else 6.0
    spacing = rate / period
    lines = np.arange(3, int(min(top, rate / 5) / spacing) + 1, 2)
    hz = lines * spacing
    total = np.array([m.sum() for m in plant.chains.masses])
    peak = total * rng.uniform(2.5, 6.0) * rng.uniform(0.8, 1.25, count)
    crossover = 2 * np.pi * rng.uniform(0.25, 0.6)
    kp = total * crossover**2
    kd = 2 * rng.uniform(0.4, 0.9) * total * crossover
    noise = float(np.exp(rng.uniform(np.log(5e-4), np.log(1e-2)))) if noise is None else noise
    bits = int(rng.integers(18, 22)) if bits is None else bits
    step = 2 * np.pi / 2.0**bits
    dither = float(rng.choice([0.5, 0.7, 0.0], p=[0.4, 0.4, 0.2]))
    rated = peak * 1.5
    if torque_quantised is None:
        torque_quantised = bool(rng.uniform() < 0.4)
    torque_noise = noise * peak
    if torque_quantised:  # a drive's thousandths, dithered by its own current noise
        torque_noise = np.maximum(torque_noise, 0.4e-3 * rated)
    orthogonal = bool(count > 1 and rng.uniform() < 0.5)
    settle = 2
    periods = int(rng.integers(2, 5)) if periods is None else periods
    fine = period * sub
    runs: list[Run] = []
    clock = 0.0

    def add(role: Role, excited: int, amplitudes: np.ndarray, lines_now: np.ndarray) -> None:
        nonlocal clock
        if drive == "smooth":
            waves = np.stack([_wave(a, lines_now, fine) for a in amplitudes], axis=1)
        else:
            waves = np.repeat(
                np.stack([_wave(a, lines_now, period) for a in amplitudes], axis=1), sub, axis=0
            )
        zero = np.zeros((1, count))
        clock += settle * period / rate
        runs.append(
            Run(
                Kind.MULTISINE,
                role,
                excited,
                waves,
                zero,
                zero,
                settle,
                periods,
                lines_now * spacing,
                period,
                clock,
                periods * period,
            )
        )
        clock += periods * period / rate + 1.0

    base = _multisine(rng, lines, hz, period, 1)[0]
    for e in range(count):
        if orthogonal:
            turn = np.exp(2j * np.pi * e * np.arange(count) / count)
            own = peak[:, None] * turn[:, None] * base
            add(Role.IDENTIFY, -1, own, lines)
        else:
            own = np.zeros((count, hz.size), dtype=complex)
            own[e] = peak[e] * _multisine(rng, lines, hz, period, 1)[0]
            add(Role.IDENTIFY, e, own, lines)
    if count == 1 or rng.uniform() < 0.7:  # a second level, another realisation
        waves = _multisine(rng, lines, hz, period, count)
        add(Role.IDENTIFY, 0 if count == 1 else -1, rng.uniform(0.3, 0.5) * peak[:, None] * waves, lines)
    if validate:
        waves = _multisine(rng, lines, hz, period, count)
        add(Role.VALIDATE, 0 if count == 1 else -1, rng.uniform(0.6, 0.8) * peak[:, None] * waves, lines)
    moves = bool(rng.uniform() < 0.6) if moves is None else moves
    if moves:
        samples = int(rate * 12)
        speed = 0.25 * rng.uniform(0.5, 1.5)
        reference, reference_rate = _move(-1, count, speed, 1.5, samples * sub, 1 / rate / sub)
        runs.append(
            Run(
                Kind.CONSTANT_VELOCITY,
                Role.IDENTIFY,
                -1,
                np.zeros((1, count)),
                reference,
                reference_rate,
                0,
                1,
                np.zeros(0),
                0,
                clock,
                samples,
            )
        )
        clock += samples / rate + 1.0
    return Setup(
        plant=plant,
        rate=rate,
        sub=sub,
        kp=kp,
        kd=kd,
        hold_sampled=drive == "sampled",
        staircase=drive != "smooth",
        peak=peak,
        torque_noise=torque_noise,
        position_noise=np.full(count, dither * step),
        resolution=np.full(count, step),
        torque_step=rated * 1e-3 if torque_quantised else np.zeros(count),
        rated=rated,
        runs=tuple(runs),
        settings={
            "rate": rate,
            "period_s": period / rate,
            "periods": periods,
            "drive": drive,
            "noise": noise,
            "bits": bits,
            "dither": dither,
            "torque_quantised": torque_quantised,
            "moves": moves,
            "orthogonal": orthogonal,
            "masses": [len(m) for m in plant.chains.masses],
            "inside_drive": bool(rng.uniform() < 0.7),
            "duration_s": clock,
        },
    )


# --- simulation ------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Active:
    """A cause at its place with numbers."""

    cause: Cause
    axis: int
    element: int
    other: int
    parameters: dict[str, float]


def _with_matrices(plant: Plant, active: tuple[Active, ...]) -> tuple[Plant, list[Any]]:
    """The plant with linear effects in its matrices, and the laws of the others."""
    mass, damping, stiffness = plant.mass.copy(), plant.damping.copy(), plant.stiffness.copy()
    laws: list[Any] = []
    for one in active:
        mass, damping, stiffness, own = one.cause.build(
            plant, mass, damping, stiffness, one.axis, one.element, one.other, one.parameters
        )
        laws += own
    return replace(plant, mass=mass, damping=damping, stiffness=stiffness), laws


def _start(setup: Setup, plant: Plant, run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Linear steady state at the first instant, so that little has to settle."""
    dofs = plant.mass.shape[0]
    if not run.period:
        return np.zeros(dofs), np.zeros(dofs)
    spectrum = np.fft.rfft(run.excitation, axis=0) * 2 / run.excitation.shape[0]
    lines = np.flatnonzero(np.abs(spectrum).max(axis=1) > 1e-6 * np.abs(spectrum).max())
    lines = lines[(lines > 0) & (lines <= 4 * round(run.lines_hz[-1] * run.period / setup.rate))]
    omega = 2 * np.pi * lines * setup.rate / run.period
    k, c = plant.stiffness.copy(), plant.damping.copy()
    k[plant.motors, plant.motors] += setup.kp
    c[plant.motors, plant.motors] += setup.kd
    full = k[None] + 1j * omega[:, None, None] * c - omega[:, None, None] ** 2 * plant.mass
    load = np.zeros((lines.size, dofs, 1), dtype=complex)
    load[:, plant.motors, 0] = spectrum[lines]
    q = np.linalg.solve(full, load)[..., 0]
    return q.sum(axis=0).real, (1j * omega[:, None] * q).sum(axis=0).real


def _simulate(
    setup: Setup,
    run: Run,
    active: tuple[Active, ...],
    *,
    settle: int | None = None,
    periods: int | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Noise-free readings (n, M) ×2 and the last period's sub-step logs ×2."""
    plant, laws = _with_matrices(setup.plant, active)
    settle = run.settle if settle is None else settle
    recorded = run.length if periods is None else periods * run.period
    samples = settle * run.period + recorded
    h, sub = setup.h, setup.sub
    q, v = _start(setup, plant, run)
    a = 2 * plant.mass + h * plant.damping + 0.5 * h * h * plant.stiffness
    rows = run.period * sub
    out = integrate(
        samples * sub,
        sub,
        h,
        np.linalg.inv(a),
        2 * plant.mass,
        plant.stiffness,
        plant.motors.astype(np.int64),
        run.excitation,
        run.reference,
        run.reference_rate,
        setup.kp,
        setup.kd,
        setup.hold_sampled,
        q,
        v,
        np.array([int(x[0]) for x in laws], dtype=np.int64),
        np.array([x[1] for x in laws], dtype=np.int64),
        np.array([x[2] for x in laws], dtype=np.int64),
        np.array([list(x[3]) + [0.0] * (4 - len(x[3])) for x in laws], dtype=float).reshape(len(laws), 4),
        run.start_time - settle * run.period / setup.rate,
        samples * sub - rows,
        rows,
    )
    skip = settle * run.period
    return out[0][skip:], out[1][skip:], out[2], out[3]


def _excess_db(setup: Setup, active: tuple[Active, ...], *, quick: bool = False) -> float:
    """Whitened power of the missing torque after a linear refit, over that of noise [dB]."""
    plant, chains = setup.plant, setup.plant.chains
    count = plant.count
    residuals, columns = [], []
    for run in setup.runs:
        if run.role is not Role.IDENTIFY or not run.period:
            continue
        _, _, y, tau = _simulate(
            setup, run, active, settle=1 if quick else None, periods=1 if quick else None
        )
        rows = y.shape[0]
        last = int(1.1 * run.lines_hz[-1] * run.period / setup.rate)
        theta = (np.fft.rfft(y, axis=0) * 2 / rows)[: last + 1]
        force = (np.fft.rfft(tau, axis=0) * 2 / rows)[: last + 1]
        omega = 2 * np.pi * np.arange(last + 1) * setup.rate / run.period
        omega[0] = 1e-9
        # The integrator's own frequency, and its torque constant over a sub-step.
        warped = 2 / setup.h * np.tan(omega * setup.h / 2)
        half = omega * setup.h / 2
        force = force * np.exp(-1j * half)[:, None] * (np.sin(half) / half)[:, None]
        z, w = plant.motion(warped)
        r = np.einsum("fij,fj->fi", z, theta) - force
        root = _noise_root(setup, run, z)

        def white(x: np.ndarray, root: np.ndarray = root) -> np.ndarray:
            solved = np.linalg.solve(root, x[..., None])[..., 0].ravel()
            return np.concatenate([solved.real, solved.imag])

        q = np.einsum("fdm,fm->fd", w, theta)
        cols = []
        for d in range(plant.mass.shape[0]):
            cols.append(-(warped**2)[:, None] * w[:, d] * q[:, d : d + 1])
        for axis, k in enumerate(chains.springs):
            for s in range(k.size):
                x, b = plant.dof(axis, s + 1), plant.dof(axis, s + 2)
                base = (w[:, x] - w[:, b]) * (q[:, x] - q[:, b])[:, None]
                cols += [base, 1j * warped[:, None] * base]
        for i in range(count):
            for j in range(i + 1, count):
                a, b = plant.ends[i], plant.ends[j]
                cols.append(-(warped**2)[:, None] * (w[:, a] * q[:, b : b + 1] + w[:, b] * q[:, a : a + 1]))
        for i in range(count):  # sampling convention
            shift = np.zeros_like(force)
            shift[:, i] = 1j * omega * force[:, i]
            cols.append(shift)
        residuals.append(white(r))
        columns.append(np.stack([white(c) for c in cols], axis=1))
    r, j = np.concatenate(residuals), np.concatenate(columns)
    scale = np.linalg.norm(j, axis=0)
    j = j / np.where(scale > 0, scale, 1.0)
    u, s, _ = np.linalg.svd(j, full_matrices=False)
    u = u[:, s > 1e-10 * s[0]]
    left = r - u @ (u.T @ r)
    return float(10 * np.log10(max(left @ left / (r.size / 2), 1e-12)))


def _noise_root(setup: Setup, run: Run, z: np.ndarray) -> np.ndarray:
    """Cholesky factors (F, M, M) of the covariance of Z n_Θ − n_T in spectra averaged over the periods."""
    per = 4.0 / (run.periods * run.period)
    quiet_p = per * (setup.position_noise**2 + setup.resolution**2 / 12)
    quiet_t = per * (setup.torque_noise**2 + setup.torque_step**2 / 12)
    return np.linalg.cholesky(np.einsum("fij,j,fkj->fik", z, quiet_p, z.conj()) + np.diag(quiet_t))


def _lost_power(setup: Setup, run: Run, position: np.ndarray, torque: np.ndarray) -> tuple[float, int]:
    """Whitened power that changed samples (n, M) put into the averaged missing torque, and its size."""
    if run.role is not Role.IDENTIFY or not run.period:
        return 0.0, 0
    last = int(1.1 * run.lines_hz[-1] * run.period / setup.rate)
    z, _ = setup.plant.motion(2 * np.pi * np.arange(1, last + 1) * setup.rate / run.period)
    root = _noise_root(setup, run, z)

    def spectrum(x: np.ndarray) -> np.ndarray:
        mean = x.reshape(run.periods, run.period, -1).mean(axis=0)
        return (np.fft.rfft(mean, axis=0) * 2 / run.period)[1 : last + 1]

    r = np.einsum("fij,fj->fi", z, spectrum(position)) - spectrum(torque)
    white = np.linalg.solve(root, r[..., None])
    return float((np.abs(white) ** 2).sum()), r.size


def _record(
    rng: np.random.Generator, setup: Setup, active: tuple[Active, ...], declared: Any
) -> tuple[Recording, float]:
    """The recording with its noise, and the dB of dropped samples (−inf where none are)."""
    experiments = []
    power, points = 0.0, 0
    dropped = [(a.axis, a.parameters["fraction"]) for a in active if a.cause.name == "dropped_samples"]
    for number, run in enumerate(setup.runs):
        position, torque, _, _ = _simulate(setup, run, active)
        demand = None
        if setup.settings["drive"] == "mixed" and run.period:
            demand = np.tile(run.excitation[:: setup.sub], (run.periods, 1))
        position = position + setup.position_noise * rng.standard_normal(position.shape)
        position = np.round(position / setup.resolution) * setup.resolution
        torque = torque + setup.torque_noise * rng.standard_normal(torque.shape)
        step = setup.torque_step
        torque = np.where(step > 0, np.round(torque / np.where(step > 0, step, 1)) * step, torque)
        for axis, fraction in dropped:
            lost = rng.uniform(size=position.shape[0]) < fraction
            lost[0] = False
            source = np.maximum.accumulate(np.where(lost, 0, np.arange(lost.size)))
            before = position.copy(), torque.copy()
            position[:, axis], torque[:, axis] = position[source, axis], torque[source, axis]
            own = _lost_power(setup, run, position - before[0], torque - before[1])
            power, points = power + own[0], points + own[1]
        inside = setup.settings["inside_drive"] or not run.period
        experiments.append(
            Experiment(
                key=f"{number:03d}",
                kind=run.kind,
                role=run.role,
                excited_axis=run.excited,
                hold_gain=np.full(setup.plant.count, np.nan) if inside else setup.kp.copy(),
                period_samples=run.period,
                frequencies_hz=run.lines_hz,
                sample_rate_hz=setup.rate,
                time=run.start_time + np.arange(position.shape[0]) / setup.rate,
                position=position,
                torque=torque,
                torque_demand=demand,
            )
        )
    recording = Recording(
        robot="hidden",
        axes=setup.plant.chains.axes,
        position_unit="m" if setup.plant.linear else "rad",
        torque_unit="N" if setup.plant.linear else "N·m",
        created="2026-11-21T10:00:00Z",
        experiments=tuple(experiments),
        masses_per_axis=tuple(int(n) for n in declared),
        rated_torque=setup.rated,
        encoder_resolution=setup.resolution,
        outcome=Outcome.COMPLETED,
        source="hidden",
    )
    return recording, float(10 * np.log10(power / points)) if power else -np.inf


# --- scales that sizes are drawn from -----------------------------------------------------------------
def _scales(setup: Setup) -> Scales:
    """Rms motion of every coordinate, per spring, and largest torques, of the linear plant."""
    position = velocity = command = 0.0
    plant = setup.plant
    spreads = []
    for run in setup.runs:
        if run.role is Role.VALIDATE or not run.period:
            continue
        rows = run.excitation.shape[0]
        spectrum = np.fft.rfft(run.excitation, axis=0) * 2 / rows
        last = int(1.05 * run.lines_hz[-1] * run.period / setup.rate)
        omega = 2 * np.pi * np.arange(1, last) * setup.rate / run.period
        k, c = plant.stiffness.copy(), plant.damping.copy()
        k[plant.motors, plant.motors] += setup.kp
        c[plant.motors, plant.motors] += setup.kd
        full = k[None] + 1j * omega[:, None, None] * c - omega[:, None, None] ** 2 * plant.mass
        load = np.zeros((omega.size, plant.mass.shape[0], 1), dtype=complex)
        load[:, plant.motors, 0] = spectrum[1:last]
        q = np.linalg.solve(full, load)[..., 0]
        drive = spectrum[1:last] - q[:, plant.motors] * (setup.kp + 1j * omega[:, None] * setup.kd)
        position = np.maximum(position, np.sqrt((np.abs(q) ** 2).sum(0) / 2))
        velocity = np.maximum(velocity, np.sqrt((np.abs(omega[:, None] * q) ** 2).sum(0) / 2))
        command = np.maximum(command, np.sqrt((np.abs(drive) ** 2).sum(0) / 2))
        spreads.append(q)
    pairs = np.zeros((plant.mass.shape[0], plant.mass.shape[0]))
    for q in spreads:
        difference = q[:, :, None] - q[:, None, :]
        pairs = np.maximum(pairs, np.sqrt((np.abs(difference) ** 2).sum(0) / 2))
    return Scales(
        position,
        velocity,
        pairs,
        np.asarray(command),
        setup.peak,
        setup.rate,
        setup.settings["duration_s"],
        setup.settings["period_s"],
        tuple((r.start_time, r.start_time + r.length / setup.rate) for r in setup.runs),
    )


def _calibrated(
    rng: np.random.Generator, setup: Setup, cause: Cause, axis: int, element: int, other: int, target: float
) -> Active:
    """The cause with its size such that the excess is ``target`` dB, within the cause's bounds."""
    draw = cause.draw(rng, setup.plant, _scales(setup), axis, element, other)

    def at(factor: float) -> Active:
        return Active(cause, axis, element, other, cause.resize(draw, factor))

    tried: dict[float, float] = {1.0: _excess_db(setup, (at(1.0),), quick=True)}
    for _ in range(6):
        low = [f for f in tried if tried[f] <= target]
        high = [f for f in tried if tried[f] > target]
        best = min(tried, key=lambda f: abs(tried[f] - target))
        if abs(tried[best] - target) < 1.5:
            break
        if low and high:  # interpolate, away from the ends
            a, b = max(low), min(high)
            share = float(np.clip((target - tried[a]) / (tried[b] - tried[a]), 0.2, 0.8))
            new = a * (b / a) ** share
        else:
            new = float(np.clip(best * 10 ** ((target - tried[best]) / 20), *cause.range))
        if min(abs(np.log(new / f)) for f in tried) < 0.01:
            break
        tried[new] = _excess_db(setup, (at(new),), quick=True)
    factor = min(tried, key=lambda f: abs(tried[f] - target))
    return at(factor)


# --- cases -----------------------------------------------------------------------------------------
def _plant(
    rng: np.random.Generator, motors: int | None, masses: tuple[int, ...] | None, linear: bool
) -> Plant:
    names = [("A1", "A2", "A3"), ("J1", "J2", "J3"), ("base", "tilt", "tool"), ("X", "Y", "Z")]
    axes = names[int(rng.integers(len(names)))]
    if masses is None:
        count = int(rng.integers(1, 4)) if motors is None else motors
        if count == 3 and not linear and rng.uniform() < 0.4:
            return paper_plant(rng, axes)
        if rng.uniform() < 0.7:
            masses = (int(rng.integers(2, 5 if count < 3 else 4)),) * count
        else:
            masses = tuple(int(n) for n in rng.integers(2, 5 if count < 3 else 4, count))
    return random_plant(rng, axes[: len(masses)], tuple(masses), linear=linear)


def make(
    cause: str | None = None,
    place: tuple[int, int] | None = None,
    size: dict[str, float] | None = None,
    *,
    seed: int = 0,
    target_db: float | None = None,
    second: str | None = None,
    motors: int | None = None,
    masses: tuple[int, ...] | None = None,
    paper: bool = False,
    linear: bool = False,
    declared: int = 0,
    **setup_options: Any,
) -> tuple[Recording, Truth]:
    """One case. ``cause`` None: null data. ``place``: (axis, element), from 0 and from 1.

    ``size``: parameters in SI; otherwise the size is found so that the effect has ``target_db``
    (drawn between −12 and 40 where None). ``second``: another cause on top. ``declared``: masses
    declared per axis minus the true number.
    """
    rng = np.random.default_rng(seed)
    if motors is None and masses is None and cause is not None:
        needed = max((CATALOGUE | OUTSIDE)[c].motors for c in (cause, second) if c)
        if needed > 1:
            motors = int(rng.integers(needed, 4))
    plant = paper_plant(rng) if paper else _plant(rng, motors, masses, linear)
    setup = _setup(rng, plant, **setup_options)
    active: list[Active] = []
    for name in (cause, second):
        if name is None:
            continue
        chosen = (CATALOGUE | OUTSIDE)[name]
        for _ in range(20):
            axis, element, other = chosen.place(rng, plant)
            if name != cause or place is None:
                if not active or (axis, element) != (active[0].axis, active[0].element):
                    break
            else:
                axis, element = place
                break
        if size is not None and name == cause:
            active.append(Active(chosen, axis, element, other, dict(size)))
        else:
            goal = float(rng.uniform(-12, 40)) if target_db is None else target_db
            active.append(_calibrated(rng, setup, chosen, axis, element, other, goal))
    db = _excess_db(setup, tuple(active)) if active else -np.inf
    true_sizes = [len(m) for m in plant.chains.masses]
    recording, lost_db = _record(rng, setup, tuple(active), [n + declared for n in true_sizes])
    db = max(db, lost_db)
    axes = plant.chains.axes
    effects = tuple(
        TrueEffect(
            a.cause.name,
            axes[a.axis],
            a.cause.element_name(plant, a.axis, a.element),
            axes[a.other] if a.other >= 0 else None,
            a.parameters,
            a.cause.name in CATALOGUE,
        )
        for a in active
    )
    if declared:
        kind = "wrong_order"
    elif not effects:
        kind = "null"
    elif len(effects) > 1:
        kind = "pair"
    else:
        kind = "catalogue" if effects[0].in_catalogue else "outside"
    return recording, Truth(seed, kind, effects, plant.chains, db, setup.settings)


def make_case(seed: int, *, kind: str | None = None, motors: int | None = None) -> tuple[Recording, Truth]:
    """A case drawn at random: 70 % one catalogue cause, else null, outside, pair or wrong order."""
    rng = np.random.default_rng([seed, 7])
    kind = kind or str(
        rng.choice(["catalogue", "null", "outside", "pair", "wrong_order"], p=[0.62, 0.12, 0.12, 0.1, 0.04])
    )
    count = int(rng.integers(1, 4)) if motors is None else motors
    linear = bool(rng.uniform() < 0.1)
    options: dict[str, Any] = {"seed": seed, "motors": count, "linear": linear}
    if kind == "null":
        return make(None, **options)
    if kind == "wrong_order":
        return make(None, declared=int(rng.choice([-1, 1])), **{**options, "linear": False})
    if kind == "outside":
        names = available(OUTSIDE, count, linear)
        return make(str(rng.choice(names)), target_db=float(rng.uniform(5, 35)), **options)
    names = available(CATALOGUE, count, linear)
    first = str(rng.choice(names))
    if kind == "pair":
        later = [n for n in names if CATALOGUE[n].pairs_with(CATALOGUE[first])]
        if not later or CATALOGUE[first].alone:
            first = "coulomb_friction"
            later = [n for n in names if CATALOGUE[n].pairs_with(CATALOGUE[first])]
        return make(first, second=str(rng.choice(later)), target_db=float(rng.uniform(10, 30)), **options)
    return make(first, **options)


__all__ = ["CATALOGUE", "OUTSIDE", "TrueEffect", "Truth", "assemble", "make", "make_case"]
