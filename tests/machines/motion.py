"""What the axes are told to do: moves, sines, sweeps, steps of constant speed."""

from __future__ import annotations

import numpy as np


def trapezoids(rng: np.random.Generator, seconds: float, dt: float, stroke: float) -> np.ndarray:
    """Point-to-point moves with ramps of speed, dwells between them."""
    pieces = [np.zeros(int(0.2 / dt))]
    while sum(p.size for p in pieces) * dt < seconds:
        start, goal = pieces[-1][-1], stroke * rng.uniform(-1, 1)
        count = max(int(rng.uniform(0.4, 2.5) / dt), 10)
        ramp = max(int(count * rng.uniform(0.15, 0.45)), 2)
        speed = np.minimum(np.minimum(np.arange(count), np.arange(count)[::-1]) / ramp, 1.0)
        pieces.append(start + (goal - start) * np.cumsum(speed) / speed.sum())
        pieces.append(np.full(int(rng.uniform(0.0, 0.4) / dt) + 1, goal))
    return np.concatenate(pieces)[: int(seconds / dt)]


def sines(rng: np.random.Generator, seconds: float, dt: float, stroke: float) -> np.ndarray:
    """Sum of four sines with no common period, faded in."""
    t = np.arange(int(seconds / dt)) * dt
    wave = np.zeros_like(t)
    for k in range(4):
        f = rng.uniform(0.15, 0.4) * 1.7**k
        wave += np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) / (1 + k)
    return stroke * np.clip(t / 0.5, 0, 1) ** 2 * (3 - 2 * np.clip(t / 0.5, 0, 1)) * wave / 2


def chirp(rng: np.random.Generator, seconds: float, dt: float, stroke: float) -> np.ndarray:
    """Sweep upwards, amplitude falling so that the speed stays."""
    t = np.arange(int(seconds / dt)) * dt
    low, high = rng.uniform(0.1, 0.3), rng.uniform(1.5, 3.0)
    rate = np.log(high / low) / seconds
    phase = 2 * np.pi * low * (np.exp(rate * t) - 1) / rate
    return stroke * np.sin(phase) * np.exp(-0.8 * rate * t)


def speeds(rng: np.random.Generator, seconds: float, dt: float, stroke: float) -> np.ndarray:
    """There and back at constant speeds of a ladder, ramps between them."""
    ladder = np.geomspace(0.03, 1.0, 6) * 2.5 * stroke
    velocity = [np.zeros(int(0.2 / dt))]
    while sum(v.size for v in velocity) * dt < seconds:
        v = float(rng.choice(ladder))
        hold = int(min(rng.uniform(0.6, 1.6) * stroke / v, 0.12 * seconds) / dt)
        ramp = np.linspace(0, 1, max(int(0.15 / dt), 2))
        shape = np.concatenate((ramp, np.ones(hold), ramp[::-1]))
        velocity += [v * shape, np.zeros(int(0.05 / dt) + 1), -v * shape, np.zeros(int(0.05 / dt) + 1)]
    return np.cumsum(np.concatenate(velocity))[: int(seconds / dt)] * dt


KINDS = {"trapezoids": trapezoids, "sines": sines, "chirp": chirp, "speeds": speeds}


def band_noise(rng: np.random.Generator, count: int, dt: float, low: float, high: float) -> np.ndarray:
    """Random torque of a band, rms 1, ends faded."""
    spectrum = np.fft.rfft(rng.standard_normal(count))
    f = np.fft.rfftfreq(count, dt)
    spectrum[(f < low) | (f > high)] = 0
    wave = np.fft.irfft(spectrum, count)
    fade = np.clip(np.minimum(np.arange(count), np.arange(count)[::-1]) * dt / 0.3, 0, 1)
    return fade * wave / wave.std()
