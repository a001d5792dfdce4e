"""Elastic axes shaken without a period: chirps, noise, production moves; friction and a drive's own loop.

``draw(seed)`` gives a recording and its truth. The integrator is this file's own: Runge-Kutta of fourth order
at four steps a sample, friction a hyperbolic tangent of the velocity with its own width. Torque is held over
each sample; the drive closes its loop once a sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from invid.recording.model import Experiment, Kind, Recording, Role

SUB = 4


@dataclass(frozen=True, eq=False)
class Truth:
    """What the recording was made from."""

    motion: str
    masses: np.ndarray
    springs: np.ndarray
    dampers: np.ndarray
    viscous: float
    coulomb: float


@njit(cache=True)
def _rates(state, torque, masses, springs, dampers, viscous, coulomb, width, out):  # type: ignore[no-untyped-def]
    count = masses.size
    for i in range(count):
        out[i] = state[count + i]
        out[count + i] = 0.0
    out[count] = torque - viscous * state[count] - coulomb * np.tanh(state[count] / width)
    for s in range(count - 1):
        pull = springs[s] * (state[s] - state[s + 1]) + dampers[s] * (state[count + s] - state[count + s + 1])
        out[count + s] -= pull
        out[count + s + 1] += pull
    for i in range(count):
        out[count + i] /= masses[i]


@njit(cache=True)
def _march(feed, wanted, speed, gain, damping, limit, step, count, masses, springs, dampers, friction):  # type: ignore[no-untyped-def]
    viscous, coulomb, width = friction
    samples = feed.size
    state = np.zeros(2 * count)
    position, velocity, torque = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    a, b, c, d = np.zeros(2 * count), np.zeros(2 * count), np.zeros(2 * count), np.zeros(2 * count)
    h = step / SUB
    for k in range(samples):
        push = feed[k] + gain * (wanted[k] - state[0]) + damping * (speed[k] - state[count])
        push = min(max(push, -limit), limit)
        position[k], velocity[k], torque[k] = state[0], state[count], push
        for _ in range(SUB):
            _rates(state, push, masses, springs, dampers, viscous, coulomb, width, a)
            _rates(state + 0.5 * h * a, push, masses, springs, dampers, viscous, coulomb, width, b)
            _rates(state + 0.5 * h * b, push, masses, springs, dampers, viscous, coulomb, width, c)
            _rates(state + h * c, push, masses, springs, dampers, viscous, coulomb, width, d)
            state = state + h / 6 * (a + 2 * b + 2 * c + d)
    return position, velocity, torque


def draw(seed: int, motion: str | None = None, *, seconds: float | None = None) -> tuple[Recording, Truth]:
    """A recording of one axis of two to four masses, and what it was made from.

    Parameters
    ----------
    motion
        "chirp", "noise" or "moves"; drawn where not given.
    """
    rng = np.random.default_rng(seed)
    drawn = str(rng.choice(["chirp", "noise", "moves"]))
    motion = motion or drawn
    rate = float(rng.choice([500.0, 1000.0, 2000.0]))
    duration = seconds or float(rng.uniform(10, 20))
    count = int(rng.integers(2, 5))
    masses = rng.uniform(0.5, 2.0, count)
    masses *= rng.uniform(0.5, 20) / masses.sum()
    # antiresonance of the motor held between 6 and 25 Hz: inside what moves excite
    springs = rng.uniform(0.7, 1.5, count - 1)
    lowest = _lowest(masses, springs)
    springs *= (2 * np.pi * rng.uniform(6, 18) / lowest) ** 2
    dampers = springs * rng.uniform(0.004, 0.02) / np.sqrt(springs[0] / masses.sum())
    total = float(masses.sum())
    samples = round(duration * rate)
    time = np.arange(samples) / rate
    reach = float(rng.uniform(0.3, 1.5))
    top = float(rng.uniform(1.0, 4.0))
    peak = total * top * 2 * np.pi * 2.0
    feed, wanted, speed = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    gain = total * (2 * np.pi * 2.5) ** 2
    damping = 1.4 * total * 2 * np.pi * 2.5
    highest = min(0.2 * rate, 3.0 * _highest(masses, springs) / (2 * np.pi))
    if motion == "chirp":
        low = 0.5
        sweep = low * (highest / low) ** (time / duration)
        phase = 2 * np.pi * np.cumsum(sweep) / rate
        feed = peak * 0.4 * np.cos(phase)
        gain, damping = 0.05 * gain, 0.2 * damping
    elif motion == "noise":
        raw = rng.standard_normal(samples)
        spectrum = np.fft.rfft(raw)
        hertz = np.fft.rfftfreq(samples, 1 / rate)
        spectrum *= (hertz > 0.3) * (hertz < highest) / np.sqrt(np.maximum(hertz, 0.3))
        feed = np.fft.irfft(spectrum, samples)
        feed *= 0.4 * peak / np.abs(feed).max()
        gain, damping = 0.05 * gain, 0.2 * damping
    else:
        wanted, speed, acceleration = _moves(rng, samples, rate, reach, top)
        feed = float(rng.uniform(0.0, 1.0)) * total * acceleration
    coulomb = float(rng.uniform(0.01, 0.06)) * peak
    viscous = float(rng.uniform(0.0, 0.03)) * peak / top
    friction = (viscous, coulomb, float(rng.uniform(0.002, 0.01)) * top)
    position, velocity, torque = _march(
        feed, wanted, speed, gain, damping, 4 * peak, 1 / rate, count, masses, springs, dampers, friction
    )
    noise = float(rng.choice([0.001, 0.003])) * peak
    resolution = 2 * np.pi / 2 ** int(rng.integers(18, 21))
    from_velocity = bool(rng.random() < 0.2)
    if from_velocity:
        read = velocity + rng.standard_normal(samples) * 2e-4 * top
        reading = np.concatenate(([0.0], np.cumsum(read[:-1]) / rate))  # as the importer sums a log up
        attributes = {"position_source": "integrated_velocity"}
    else:
        reading = (
            np.round((position + rng.standard_normal(samples) * resolution / 3) / resolution) * resolution
        )
        attributes = {}
    recorded = np.round((torque + noise * rng.standard_normal(samples)) / (peak / 2000)) * (peak / 2000)
    experiment = Experiment(
        key="000",
        kind=Kind.OTHER,
        excited_axis=0,
        role=Role.IDENTIFY,
        hold_gain=np.array([np.nan]),
        period_samples=0,
        frequencies_hz=np.zeros(0),
        sample_rate_hz=rate,
        time=time,
        position=reading[:, None],
        torque=recorded[:, None],
        attributes=attributes,
    )
    recording = Recording(
        created="2026-01-01T00:00:00+00:00",
        robot="aperiodic",
        axes=("A1",),
        position_unit="rad",
        torque_unit="N·m",
        rated_torque=np.array([peak]),
        encoder_resolution=None if from_velocity else np.array([resolution]),
        experiments=(experiment,),
    )
    return recording, Truth(motion, masses, springs, dampers, viscous, coulomb)


def _stiffness(springs: np.ndarray) -> np.ndarray:
    count = springs.size + 1
    k = np.zeros((count, count))
    for s, value in enumerate(springs):
        k[s : s + 2, s : s + 2] += value * np.array([[1, -1], [-1, 1]])
    return k


def _modes(masses: np.ndarray, springs: np.ndarray, held: bool) -> np.ndarray:
    scale = 1 / np.sqrt(masses)
    matrix = scale[:, None] * _stiffness(springs) * scale
    matrix = matrix[1:, 1:] if held else matrix
    out: np.ndarray = np.sqrt(np.maximum(np.linalg.eigvalsh(matrix), 0))
    return out


def _lowest(masses: np.ndarray, springs: np.ndarray) -> float:
    return float(_modes(masses, springs, True)[0])


def _highest(masses: np.ndarray, springs: np.ndarray) -> float:
    return float(_modes(masses, springs, False)[-1])


def _moves(
    rng: np.random.Generator, samples: int, rate: float, reach: float, top: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Point to point with trapezoidal velocity (jumps of acceleration) and short rests."""
    acceleration = np.zeros(samples)
    at, k = 0.0, 0
    while k < samples:
        goal = float(rng.uniform(-reach, reach))
        way, sign = abs(goal - at), np.sign(goal - at)
        rise = float(rng.uniform(0.04, 0.15))
        speed = min(top, way / (2 * rise))
        cruise = way / speed - rise
        parts = [(rise, sign * speed / rise), (max(cruise, 0), 0.0), (rise, -sign * speed / rise)]
        parts.append((float(rng.uniform(0.05, 0.4)), 0.0))
        for length, value in parts:
            end = min(k + round(length * rate), samples)
            acceleration[k:end] = value
            k = end
        at = goal
    speed = np.cumsum(acceleration) / rate
    return np.cumsum(speed) / rate, speed, acceleration
