"""Simulates a hidden case, measures the size of its effect, and writes what the sensors saw."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hidden.causes import Cause, Scales
from hidden.integrator import integrate
from hidden.plants import Plant
from hidden.setup import Run, Setup
from invid.recording.model import Experiment, Outcome, Recording, Role


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
    if not run.period or not run.settle:
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


def simulate(
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


def excess_db(setup: Setup, active: tuple[Active, ...], *, quick: bool = False) -> float:
    """Whitened power of the missing torque after a linear refit, over that of noise [dB]."""
    plant, chains = setup.plant, setup.plant.chains
    count = plant.count
    residuals, columns = [], []
    for run in setup.runs:
        if run.role is not Role.IDENTIFY or not run.period:
            continue
        run = replace(run, settle=max(run.settle, 2))  # the size is that in steady state
        _, _, y, tau = simulate(setup, run, active, settle=1 if quick else None, periods=1 if quick else None)
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
    if not (np.isfinite(r).all() and np.isfinite(j).all()):
        return 300.0  # so large that the plant ran away: the search for a size goes lower
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


def record(
    rng: np.random.Generator, setup: Setup, active: tuple[Active, ...], declared: Any
) -> tuple[Recording, float, dict[int, float]]:
    """The recording with its noise, the dB of dropped samples (−inf where none are), and the share of them
    that every axis lost: of a few rows in a thousand chance takes a fifth more or fewer than asked for.
    """
    experiments = []
    power, points, rows = 0.0, 0, 0
    gone: dict[int, float] = {}
    dropped = [(a.axis, a.parameters["fraction"]) for a in active if a.cause.name == "dropped_samples"]
    for number, run in enumerate(setup.runs):
        position, torque, _, _ = simulate(setup, run, active)
        demand = None
        goes = run.reference.any()  # a move, whose reference nobody logs
        if setup.settings["drive"] == "mixed" and not goes:
            demand = np.tile(run.excitation[:: setup.sub], (run.periods, 1))
        position = position + setup.position_noise * rng.standard_normal(position.shape)
        position = np.round(position / setup.resolution) * setup.resolution
        torque = torque + setup.torque_noise * rng.standard_normal(torque.shape)
        step = setup.torque_step
        torque = np.where(step > 0, np.round(torque / np.where(step > 0, step, 1)) * step, torque)
        for axis, fraction in dropped:
            lost = rng.uniform(size=position.shape[0]) < fraction
            lost[0] = False
            gone[axis] = gone.get(axis, 0.0) + float(lost.sum())
            source = np.maximum.accumulate(np.where(lost, 0, np.arange(lost.size)))
            before = position.copy(), torque.copy()
            position[:, axis], torque[:, axis] = position[source, axis], torque[source, axis]
            own = _lost_power(setup, run, position - before[0], torque - before[1])
            power, points = power + own[0], points + own[1]
        rows += position.shape[0]
        inside = setup.settings["inside_drive"] or goes
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
    db = float(10 * np.log10(power / points)) if power else -np.inf
    return recording, db, {axis: count / rows for axis, count in gone.items()}


def scales(setup: Setup) -> Scales:
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
        tuple(
            (r.start_time, r.start_time + r.length / setup.rate)
            for r in setup.runs
            if r.period and r.role is Role.IDENTIFY
        ),
    )
