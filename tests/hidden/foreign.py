"""A second generator, as another hand would write it: Runge-Kutta, smoothed friction, any excitation.

It shares nothing with the first but the containers: classical RK4 at ten steps a sample, friction rounded by
tanh over a width drawn from a half to ten per cent of the rms velocity, torque held over the step and not
the sample, and records that are periodic multisines of odd or of all lines, chirps, aperiodic noise or
stepped sines, with or without a validation experiment, with or without noise on the torque, 16 to 20 bits.

``Truth.db`` is coarser here: power of the effect's force over the power of the torque's noise (a thousandth
of the peak where the torque has none), both as sampled.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from hidden.generator import TrueEffect, Truth
from invid.model.chains import CoupledChains
from invid.recording.model import Experiment, Kind, Outcome, Recording, Role

(
    NOTHING,
    DRY,
    WET,
    CONSTANT,
    CUBIC,
    GAP,
    WEIGHT,
    RIPPLE,
    SQUARE_DRAG,
    STRIBECK,
    SCALE,
    LIMIT,
    SLOW_WAVE,
) = range(13)
LAWS = {
    "null": NOTHING,
    "coulomb_friction": DRY,
    "viscous_friction": WET,
    "torque_offset": CONSTANT,
    "cubic_stiffness": CUBIC,
    "backlash": GAP,
    "gravity": WEIGHT,
    "cogging": RIPPLE,
    "stribeck_friction": STRIBECK,
    "torque_gain": SCALE,
    "torque_saturation": LIMIT,
    "torque_delay": NOTHING,
    "square_drag": SQUARE_DRAG,  # not in the catalogue, nor is the next
    "hum": SLOW_WAVE,
}
OUTSIDE = ("square_drag", "hum")
EXCITATIONS = ("odd", "full", "chirp", "noise", "stepped")
STEPS = 10


@numba.njit(cache=True)
def _resistance(
    law: int, at: int, p: np.ndarray, q: np.ndarray, v: np.ndarray, t: float
) -> tuple[float, float]:
    """What the effect takes from the mass ``at`` and what it gives to the next."""
    if law == DRY:
        return p[0] * np.tanh(v[at] / p[1]), 0.0
    if law == WET:
        return p[0] * v[at], 0.0
    if law == CONSTANT:
        return p[0], 0.0
    if law == CUBIC:
        f = p[0] * (q[at] - q[at + 1]) ** 3
        return f, f
    if law == GAP:
        f = -p[1] * min(max(q[at] - q[at + 1], -0.5 * p[0]), 0.5 * p[0])
        return f, f
    if law == WEIGHT:
        return p[0] * np.sin(q[at] + p[1]), 0.0
    if law == RIPPLE:
        return p[0] * np.sin(p[1] * q[at] + p[2]), 0.0
    if law == SQUARE_DRAG:
        return p[0] * v[at] * abs(v[at]), 0.0
    if law == STRIBECK:
        return (p[0] + (p[1] - p[0]) * np.exp(-((v[at] / p[2]) ** 2))) * np.tanh(v[at] / p[3]), 0.0
    if law == SLOW_WAVE:
        return p[0] * np.sin(p[1] * t), 0.0
    return 0.0, 0.0


@numba.njit(cache=True)
def _march(
    inverse: np.ndarray,
    damping: np.ndarray,
    stiffness: np.ndarray,
    motors: np.ndarray,
    waves: np.ndarray,
    kp: np.ndarray,
    kd: np.ndarray,
    h: float,
    law: int,
    at: int,
    p: np.ndarray,
    late: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions and torques at the samples, and what the effect took there."""
    samples, axes, n = waves.shape[0], motors.size, inverse.shape[0]
    q, v = np.zeros(n), np.zeros(n)
    position, torque, taken = np.zeros((samples, axes)), np.zeros((samples, axes)), np.zeros(samples)
    line = np.zeros((late + 1, axes))
    kq, kv = np.zeros((4, n)), np.zeros((4, n))
    qs, vs, force, tau = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(axes)
    axis = np.searchsorted(motors, at, side="right") - 1
    for k in range(samples * STEPS):
        for a in range(axes):
            tau[a] = waves[k // STEPS, a] - kp[a] * q[motors[a]] - kd[a] * v[motors[a]]
        if k % STEPS == 0:
            for a in range(axes):
                position[k // STEPS, a] = q[motors[a]]
            torque[k // STEPS] = tau
            taken[k // STEPS] = _resistance(law, at, p, q, v, k * h)[0]
        line[k % (late + 1)] = tau
        acting = line[(k + 1) % (late + 1)].copy()
        if law == SCALE:
            acting[axis] *= p[0]
        if law == LIMIT:
            acting[axis] = min(max(acting[axis], -p[0]), p[0])
        if k % STEPS == 0 and (law in (SCALE, LIMIT) or late > 0):
            taken[k // STEPS] = tau[axis] - acting[axis]
        for stage in range(4):
            share = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            for i in range(n):
                qs[i] = q[i] + (share * h * kq[stage - 1, i] if stage else 0.0)
                vs[i] = v[i] + (share * h * kv[stage - 1, i] if stage else 0.0)
            for i in range(n):
                force[i] = 0.0
                for j in range(n):
                    force[i] -= stiffness[i, j] * qs[j] + damping[i, j] * vs[j]
            for a in range(axes):
                force[motors[a]] += acting[a]
            here, there = _resistance(law, at, p, qs, vs, (k + share) * h)
            force[at] -= here
            if there != 0.0:
                force[at + 1] += there
            for i in range(n):
                kq[stage, i] = vs[i]
                kv[stage, i] = 0.0
                for j in range(n):
                    kv[stage, i] += inverse[i, j] * force[j]
        q += h / 6 * (kq[0] + 2 * kq[1] + 2 * kq[2] + kq[3])
        v += h / 6 * (kv[0] + 2 * kv[1] + 2 * kv[2] + kv[3])
    return position, torque, taken


def _plant(rng: np.random.Generator, axes: int, masses: int) -> tuple[CoupledChains, np.ndarray, np.ndarray]:
    m = [rng.uniform(0.5, 3.0, masses) for _ in range(axes)]
    k = [10 ** rng.uniform(3.0, 4.0, masses - 1) for _ in range(axes)]
    n = axes * masses
    mass, stiffness = np.diag(np.concatenate(m)), np.zeros((n, n))
    coupling = np.zeros((axes, axes))
    for a in range(axes):
        for s in range(masses - 1):
            i = a * masses + s
            stiffness[i : i + 2, i : i + 2] += k[a][s] * np.array([[1.0, -1.0], [-1.0, 1.0]])
        for b in range(a):
            i, j = (a + 1) * masses - 1, (b + 1) * masses - 1
            coupling[a, b] = coupling[b, a] = 0.2 * np.sqrt(mass[i, i] * mass[j, j])
            mass[i, j] = mass[j, i] = coupling[a, b]
    modes = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)[axes:])
    share = 0.02 / modes[0]
    chains = CoupledChains(
        masses=tuple(m), springs=tuple(k), dampers=tuple(share * x for x in k), couplings=coupling
    )
    return chains, mass, stiffness


def _wave(
    rng: np.random.Generator, kind: str, period: int, repeats: int, rate: float, band: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Excitation of peak one and the lines that a file would name."""
    t = np.arange(period) / rate

    def sines(hz: np.ndarray) -> np.ndarray:
        phases = rng.uniform(0, 2 * np.pi, hz.size)
        out: np.ndarray = sum(
            (f**-0.5 * np.cos(2 * np.pi * f * t + a) for f, a in zip(hz, phases, strict=True)),
            np.zeros(period),
        )
        return out

    lines = np.arange(1, period // 2, 2 if kind == "odd" else 1) * rate / period
    lines = lines[(lines > band[0]) & (lines < band[1])]
    lines = lines[:: max(1, lines.size // 300)]
    if kind in ("odd", "full"):
        wave = sines(lines)
        return np.tile(wave / np.abs(wave).max(), repeats + 1), lines
    if kind == "noise":
        wave = np.concatenate([sines(lines) for _ in range(repeats + 1)])
        wave *= np.minimum(1.0, np.arange(wave.size) / rate / 0.5)
        return wave / np.abs(wave).max(), np.zeros(0)
    if kind == "stepped":
        hz = np.geomspace(band[0] * 2, band[1], 24)
        at = np.minimum(np.arange(period * repeats) * hz.size // (period * repeats), hz.size - 1)
        return np.sin(2 * np.pi * np.cumsum(hz[at]) / rate) * (hz[0] / hz[at]) ** 0.3, np.zeros(0)
    long = period * repeats / rate
    t = np.arange(period * repeats) / rate
    hz = band[0] * (band[1] / band[0]) ** (t / long)
    ends = np.minimum(1.0, np.minimum(t, long - t) / (0.03 * long))
    return np.sin(2 * np.pi * np.cumsum(hz) / rate) * ends, np.zeros(0)


def make_foreign(
    seed: int, *, cause: str | None = None, excitation: str | None = None, motors: int | None = None
) -> tuple[Recording, Truth]:
    """One recording with one effect (or none) drawn from ``seed``."""
    rng = np.random.default_rng([seed, 23])
    axes = int(rng.integers(1, 3)) if motors is None else motors
    masses = int(rng.integers(2, 4))
    drawn, shaken = str(rng.choice(list(LAWS))), str(rng.choice(EXCITATIONS))
    cause, excitation = cause or drawn, excitation or shaken
    if cause == "torque_gain":
        axes = max(axes, 2)
    chains, mass, stiffness = _plant(rng, axes, masses)
    modes = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)[axes:])
    low, top = float(modes[0]) / 2 / np.pi, float(modes[-1]) / 2 / np.pi
    damping = 0.02 / float(modes[0]) * stiffness
    rate = 500.0 * np.ceil(max(float(rng.choice([500.0, 1000.0, 2000.0])), 12 * top) / 500.0)
    period, repeats = int(2 ** np.round(np.log2(rate * 16 / low))), 3
    total = np.array([m.sum() for m in chains.masses])
    kp = total * (2 * np.pi * 0.15 * low) ** 2
    kd = 1.4 * total * (2 * np.pi * 0.15 * low)
    peak = 0.2 * low**2 * total
    motor = np.arange(axes) * masses
    roles = [(a, Role.IDENTIFY, 1.0) for a in range(axes)]
    if rng.uniform() < 0.7:
        roles += [(a, Role.VALIDATE, float(rng.uniform(0.4, 0.8))) for a in range(axes)]
    band = (0.1 * low, 1.3 * top)
    waves = []
    for a, _, size in roles:
        wave, hz = _wave(rng, excitation, period, repeats, rate, band)
        all_axes = np.zeros((wave.size, axes))
        all_axes[:, a] = size * peak[a] * wave
        waves.append((all_axes, hz))
    inverse = np.linalg.inv(mass)
    axis = int(rng.integers(axes))
    at = int(motor[axis])
    element = f"mass {1}"
    if cause in ("cubic_stiffness", "backlash"):
        spring = int(rng.integers(masses - 1))
        at, element = at + spring, f"spring {spring + 1}"

    def run(wave: np.ndarray, law: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        h = 1.0 / rate / STEPS
        out: tuple[np.ndarray, np.ndarray, np.ndarray] = _march(
            inverse, damping, stiffness, motor, wave, kp, kd, h, law, at, p, late
        )
        return out

    p, late, true = np.zeros(4), 0, {}
    linear = run(waves[axis][0], NOTHING)
    speed = float(np.std(np.gradient(linear[0][:, axis]) * rate))
    travel, effort = float(np.std(linear[0][:, axis])), float(np.std(linear[1][:, axis]))
    size = float(10 ** rng.uniform(-1.2, -0.3))
    if cause == "coulomb_friction":
        p[:2] = size * effort, speed * 10 ** rng.uniform(-2.3, -1.0)
        true = {"torque": p[0]}
    elif cause == "viscous_friction":
        p[0] = size * effort / speed
        true = {"coefficient": p[0]}
    elif cause == "torque_offset":
        p[0] = size * effort
        true = {"torque": p[0]}
    elif cause == "gravity":
        p[:2] = size * effort / np.clip(3 * travel, 0.2, 1.0), rng.uniform(0.3, 1.2)
        true = {"torque": p[0]}
    elif cause == "cogging":
        p[:3] = 0.5 * size * effort, round(12 / max(6 * travel, 0.1)), rng.uniform(0, 6)
        true = {"torque": p[0], "cycles_per_rev": p[1]}
    elif cause == "cubic_stiffness":
        k = chains.springs[axis][at - int(motor[axis])]
        p[0] = 0.125 * size * k / (effort / k) ** 2
        true = {"coefficient": p[0]}
    elif cause == "backlash":
        k = chains.springs[axis][at - int(motor[axis])]
        p[:2] = size * effort / k, k
        true = {"gap": p[0]}
    elif cause == "stribeck_friction":
        p[:] = 0.5 * size * effort, size * effort, 0.3 * speed, 0.01 * speed
        true = {"coulomb": p[0], "static": p[1], "velocity": p[2]}
    elif cause == "torque_gain":
        p[0] = 1.03 + 0.3 * size
        true = {"gain": p[0]}
    elif cause == "torque_saturation":
        p[0] = rng.uniform(0.5, 0.85) * float(np.abs(linear[1][:, axis]).max())
        true = {"limit": p[0]}
    elif cause == "torque_delay":
        late = int(STEPS * rng.uniform(1.2, 3))
        true = {"delay": late / rate / STEPS}
    elif cause == "square_drag":
        p[0] = size * effort / speed**2
    elif cause == "hum":
        p[:2] = size * effort, 2 * np.pi * 0.37 * low
    results = [run(wave, LAWS[cause]) for wave, _ in waves]
    step = 2 * np.pi / 2 ** int(rng.integers(16, 21))
    noise = 0.0 if rng.uniform() < 0.2 else float(10 ** rng.uniform(-3.3, -2.3))
    named, inside = bool(rng.uniform() < 0.7), bool(rng.uniform() < 0.6)
    with_demand = bool(rng.uniform() < 0.5)
    experiments, clock, power, quiet = [], 0.0, 0.0, 0.0
    periodic = excitation in ("odd", "full")
    for number, ((a, role, _), (wave, hz), (position, torque, taken)) in enumerate(
        zip(roles, waves, results, strict=True)
    ):
        first = period if periodic else 0
        jitter = rng.normal(0, 0.3, position[first:].shape)
        shown = np.round(position[first:] / step + jitter) * step
        experiments.append(
            Experiment(
                key=f"{number:03d}",
                kind={"odd": Kind.MULTISINE, "full": Kind.MULTISINE, "chirp": Kind.CHIRP}.get(
                    excitation, Kind.OTHER
                ),
                role=role,
                excited_axis=a,
                hold_gain=np.full(axes, np.nan) if inside else kp.copy(),
                period_samples=period if periodic else 0,
                frequencies_hz=hz,
                sample_rate_hz=rate,
                time=clock + np.arange(shown.shape[0]) / rate,
                position=shown,
                torque=torque[first:] + noise * peak * rng.normal(size=shown.shape),
                torque_demand=wave[first:].copy() if with_demand else None,
            )
        )
        clock += wave.shape[0] / rate + 1.0
        power += float(np.mean(taken**2))
        quiet += float((max(noise, 1e-3) * peak[axis]) ** 2)
    names = tuple(f"A{a + 1}" for a in range(axes))
    recording = Recording(
        robot="foreign",
        axes=names,
        position_unit="rad",
        torque_unit="N·m",
        created="2026-11-21T10:00:00Z",
        experiments=tuple(experiments),
        masses_per_axis=(masses,) * axes if named else None,
        outcome=Outcome.COMPLETED,
        source="foreign",
    )
    where: str | None = element if cause not in ("torque_gain", "torque_saturation", "torque_delay") else None
    effects: tuple[TrueEffect, ...] = ()
    if cause != "null":
        either = cause == "torque_gain" and axes == 2
        # The line of late samples is every axis'.
        everywhere = names if cause == "torque_delay" else (names[axis],)
        effects = tuple(
            TrueEffect(cause, name, where, None, dict(true), cause not in OUTSIDE, either)
            for name in everywhere
        )
    kind = "null" if cause == "null" else "outside" if cause in OUTSIDE else "catalogue"
    db = float(10 * np.log10(power / quiet)) if power else -np.inf
    settings: dict[str, Any] = {
        "masses": [masses] * axes,
        "drive": excitation,
        "rate": rate,
        "noise": noise,
        "validate": len(roles) > axes,
        "inside_drive": inside,
    }
    named_chains = CoupledChains(
        masses=chains.masses,
        springs=chains.springs,
        dampers=chains.dampers,
        couplings=chains.couplings,
        axes=names,
    )
    return recording, Truth(seed, kind, effects, named_chains, db, settings)
