"""Plants, laws, drives and integration of the whole cells (``cells.py``); no code is shared with others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numba
import numpy as np

H = 1e-4
"""Largest step of the integration [s]."""


class Law(IntEnum):
    """A force between masses a and b, or of a alone (b < 0); ``p`` in brackets."""

    PLAY = 0  # [gap, stiffness, damping]
    HARDENING = 1  # [coefficient]
    DRY = 2  # [torque, width]
    WET = 3  # [coefficient]
    GEAR = 4  # [amplitude, cycles, phase, stiffness, damping]
    TIE = 5  # [stiffness]
    WEIGHT = 6  # [torque, angle]
    RIPPLE = 7  # [torque, cycles, phase]
    JOINT = 8  # [up, down, viscous up, viscous down, static over sliding, Stribeck velocity, width]
    SWAY = 9  # [coefficient] q·v: not in the catalogue
    MODE = 10  # [mass, stiffness, damping]: in the matrices


@numba.njit(cache=True)
def force(law: int, p: np.ndarray, x: float, v: float, q: float, qv: float) -> float:
    """What a law takes: deflection or position x, its rate v, position q and rate qv of mass a."""
    if law == 0:
        inside = abs(x) < 0.5 * p[0]
        return -p[1] * min(max(x, -0.5 * p[0]), 0.5 * p[0]) - (p[2] * v if inside else 0.0)
    if law == 1:
        return p[0] * x**3
    if law == 2:
        return p[0] * np.tanh(v / p[1])
    if law == 3:
        return p[0] * v
    if law == 4:
        turn = p[1] * q + p[2]
        return -p[0] * (p[3] * np.sin(turn) + p[4] * p[1] * qv * np.cos(turn))
    if law == 5:
        return p[0] * x
    if law == 6:
        return p[0] * np.sin(x + p[1])
    if law == 7:
        return p[0] * np.sin(p[1] * x + p[2])
    if law == 8:
        up = 0.5 * (1.0 + np.tanh(v / p[6]))
        dry = (up * p[0] + (1.0 - up) * p[1]) * (1.0 + (p[4] - 1.0) * np.exp(-((v / p[5]) ** 2)))
        return dry * np.tanh(v / p[6]) + (p[2] if v > 0 else p[3]) * v
    if law == 9:
        return p[0] * x * v
    return 0.0


@numba.njit(cache=True)
def taken(law: int, p: np.ndarray, q: np.ndarray, v: np.ndarray, a: int, b: int) -> np.ndarray:
    """(n,) force of a law along a motion (n, D)."""
    out = np.zeros(q.shape[0])
    for k in range(q.shape[0]):
        x, xv = q[k, a], v[k, a]
        if b >= 0:
            x, xv = x - q[k, b], xv - v[k, b]
        out[k] = force(law, p, x, xv, q[k, a], v[k, a])
    return out


@numba.njit(cache=True)
def march(
    wave, repeats, sub, h, inverse, damping, stiffness, motors, bias, kp, loop, filt, step, error, laws, at,
    par,
):  # fmt: skip
    """Readings, reported and commanded torque (n, M), motion (n, D): classic Runge–Kutta."""
    period, axes = wave.shape
    n, dofs = period * repeats, inverse.shape[0]
    reading, torque, command = np.zeros((n, axes)), np.zeros((n, axes)), np.zeros((n, axes))
    motion, rates = np.zeros((n, dofs)), np.zeros((n, dofs))
    q, v = np.zeros(dofs), np.zeros(dofs)
    acting, seen = bias.copy(), bias.copy()
    kq, kv = np.zeros((4, dofs)), np.zeros((4, dofs))
    qs, vs, f = np.zeros(dofs), np.zeros(dofs), np.zeros(dofs)
    for k in range(n):
        motion[k], rates[k] = q, v
        for i in range(axes):
            true = q[motors[i]]
            reading[k, i] = (
                true + error[i, 0] * np.sin(error[i, 1] * true) + error[i, 2] * np.sin(2 * error[i, 1] * true)
            )
            counted = np.round(reading[k, i] / step[i]) * step[i]
            torque[k, i] = seen[i]
            command[k, i] = bias[i] + wave[k % period, i] - kp[i] * counted
        for _ in range(sub):
            for i in range(axes):
                acting[i] += (command[k, i] - acting[i]) * (1.0 - np.exp(-h / loop[i]))
                seen[i] += (acting[i] - seen[i]) * (1.0 - np.exp(-h / filt[i]))
            for stage in range(4):
                share = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
                for d in range(dofs):
                    qs[d] = q[d] + (share * h * kq[stage - 1, d] if stage else 0.0)
                    vs[d] = v[d] + (share * h * kv[stage - 1, d] if stage else 0.0)
                for d in range(dofs):
                    f[d] = 0.0
                    for e in range(dofs):
                        f[d] -= stiffness[d, e] * qs[e] + damping[d, e] * vs[e]
                for i in range(axes):
                    f[motors[i]] += acting[i]
                for j in range(laws.size):
                    a, b = at[j, 0], at[j, 1]
                    x, xv = qs[a], vs[a]
                    if b >= 0:
                        x, xv = x - qs[b], xv - vs[b]
                    one = force(laws[j], par[j], x, xv, qs[a], vs[a])
                    f[a] -= one
                    if laws[j] == 4:  # no gear makes energy: its motor side feels the slope of the error
                        slope = par[j, 0] * par[j, 1] * np.cos(par[j, 1] * qs[a] + par[j, 2])
                        f[a] += (par[j, 3] * x + par[j, 4] * xv + one) * slope
                    if b >= 0:
                        f[b] += one
                for d in range(dofs):
                    kq[stage, d] = vs[d]
                    kv[stage, d] = 0.0
                    for e in range(dofs):
                        kv[stage, d] += inverse[d, e] * f[e]
            for d in range(dofs):
                q[d] += h / 6 * (kq[0, d] + 2 * kq[1, d] + 2 * kq[2, d] + kq[3, d])
                v[d] += h / 6 * (kv[0, d] + 2 * kv[1, d] + 2 * kv[2, d] + kv[3, d])
    return reading, torque, command, motion, rates


@dataclass(frozen=True, eq=False)
class CellPlant:
    """Chains tied by the coupling of their loads; coordinates one after the other, extra modes last."""

    masses: tuple[np.ndarray, ...]
    springs: tuple[np.ndarray, ...]
    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    motors: np.ndarray
    ends: np.ndarray

    def grown(self, a: int, p: tuple[float, ...]) -> CellPlant:
        """The plant with a further mass on a spring at ``a``."""
        n = self.mass.shape[0]
        bigger = [np.pad(m, ((0, 1), (0, 1))) for m in (self.mass, self.damping, self.stiffness)]
        bigger[0][n, n] = p[0]
        for m, value in zip(bigger[1:], (p[2], p[1]), strict=True):
            m[np.ix_([a, n], [a, n])] += value * np.array([[1.0, -1.0], [-1.0, 1.0]])
        return replace(self, mass=bigger[0], damping=bigger[1], stiffness=bigger[2])


def drawn_plant(rng: np.random.Generator, sizes: tuple[int, ...]) -> CellPlant:
    """Chains with modes between 2 and 16 Hz that lie apart."""
    ends = np.cumsum(sizes) - 1
    motors = ends - np.array(sizes) + 1
    scale = float(np.exp(rng.uniform(np.log(0.5), np.log(8.0))))
    while True:
        masses = [scale * rng.uniform(0.6, 3.0, n) for n in sizes]
        mass = np.diag(np.concatenate(masses))
        for i, j in zip(*np.triu_indices(len(sizes), 1), strict=True):
            a, b = ends[i], ends[j]
            mass[a, b] = mass[b, a] = rng.uniform(-0.3, 0.3) * np.sqrt(mass[a, a] * mass[b, b])
        stiffness, damping, springs = np.zeros_like(mass), np.zeros_like(mass), []
        for start, m in zip(motors, masses, strict=True):
            both = m[:-1] * m[1:] / (m[:-1] + m[1:])
            k = (2 * np.pi * rng.uniform(3.0, 9.0, m.size - 1)) ** 2 * both
            springs.append(k)
            for s in range(k.size):
                at = np.ix_([start + s, start + s + 1], [start + s, start + s + 1])
                pair = np.array([[1.0, -1.0], [-1.0, 1.0]])
                stiffness[at] += k[s] * pair
                damping[at] += 2 * rng.uniform(0.01, 0.03) * np.sqrt(k[s] * both[s]) * pair
        if np.linalg.eigvalsh(mass)[0] < 0.1 * min(m[-1] for m in masses):
            continue
        hz = np.sort(np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(mass, stiffness)))))[len(sizes) :]
        hz = hz / (2 * np.pi)
        if hz[0] > 2.0 and hz[-1] < 16.0 and (np.diff(np.log(hz)) > 0.05).all():
            return CellPlant(tuple(masses), tuple(springs), mass, damping, stiffness, motors, ends)


@dataclass(frozen=True, eq=False)
class Drives:
    """Drives and sensors, one number an axis [SI]."""

    rate: float
    period: int
    hz: np.ndarray
    kp: np.ndarray
    loop: np.ndarray
    filt: np.ndarray
    step: np.ndarray
    error: np.ndarray
    torque_step: np.ndarray
    torque_noise: np.ndarray
    peak: np.ndarray
    rated: np.ndarray

    @property
    def sub(self) -> int:
        return int(np.ceil(1.0 / self.rate / H))


def drawn_drives(rng: np.random.Generator, plant: CellPlant) -> Drives:
    count = plant.motors.size
    rate = float(rng.choice([250.0, 500.0, 1000.0], p=[0.3, 0.5, 0.2]))
    period = int(8 * rate)
    hz = np.sqrt(np.abs(np.linalg.eigvals(np.linalg.solve(plant.mass, plant.stiffness)))).max() / 2 / np.pi
    lines = np.arange(3, int(1.3 * hz * 8), 2)
    total = np.array([m.sum() for m in plant.masses])
    peak = total * rng.uniform(3.0, 6.0, count)
    bits = int(rng.integers(18, 22))
    step = np.full(count, 2 * np.pi / 2.0**bits)
    error = np.zeros((count, 3))
    error[:, 0] = rng.uniform(0.3, 1.5, count) * step
    error[:, 1] = rng.choice([512.0, 1024.0, 2048.0])
    error[:, 2] = rng.uniform(0.2, 0.8, count) * step
    rated = 1.5 * peak
    return Drives(
        rate, period, lines / 8.0, total * (2 * np.pi * rng.uniform(0.25, 0.5)) ** 2,
        rng.uniform(0.5e-3, 2e-3, count), rng.uniform(0.2e-3, 2e-3, count), step, error,
        1e-3 * rated, np.maximum(10 ** rng.uniform(-3.3, -2.3) * peak, 0.4e-3 * rated), peak, rated,
    )  # fmt: skip


def multisine(rng: np.random.Generator, drives: Drives) -> np.ndarray:
    """One period (P,) with peak one, amplitudes falling as f^−½, the flattest of ten."""
    t = np.arange(drives.period) / drives.rate
    best = np.zeros(0)
    for _ in range(10):
        turns = rng.uniform(0, 2 * np.pi, drives.hz.size)
        wave = sum(f**-0.5 * np.cos(2 * np.pi * f * t + a) for f, a in zip(drives.hz, turns, strict=True))
        wave = wave / np.abs(wave).max()
        best = wave if not best.size or wave.std() > best.std() else best
    return best


def joint(rng: np.random.Generator, peak: float, speed: float) -> tuple[float, ...]:
    """Friction of a motor; one in two Stribeck, one in three differs by direction."""
    dry = peak * rng.uniform(0.02, 0.08)
    wet = peak * rng.uniform(0.01, 0.05) / speed
    other = rng.uniform(0.5, 0.9) if rng.uniform() < 0.33 else 1.0
    static = rng.uniform(1.2, 1.7) if rng.uniform() < 0.5 else 1.0
    width = rng.uniform(1.5e-3, 6e-3)
    return dry, dry * other, wet, wet * other, static, max(speed * rng.uniform(0.08, 0.3), 3 * width), width
