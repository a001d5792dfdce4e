"""Drives, sensors and plan of a hidden case: all but the effect."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hidden.plants import Plant, flexible_modes
from invid.recording.model import Kind, Role


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


def draw_setup(
    rng: np.random.Generator,
    plant: Plant,
    *,
    noise: float | None = None,
    bits: int | None = None,
    moves: bool | None = None,
    validate: bool = True,
    validate_level: float | None = None,
    torque_quantised: bool | None = None,
    drive: str | None = None,
    periods: int | None = None,
    from_rest: bool | None = None,
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
    # One recording in ten starts from rest with the excitation: its first periods ring.
    if from_rest is None:
        from_rest = bool(rng.uniform() < 0.1)
    settle = 0 if from_rest else 2
    if periods is None:
        periods = int(rng.integers(2, 5)) + 2 * from_rest
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
        level = rng.uniform(0.6, 0.8)
        level = level if validate_level is None else validate_level
        add(Role.VALIDATE, 0 if count == 1 else -1, level * peak[:, None] * waves, lines)
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
            "from_rest": from_rest,
            "masses": [len(m) for m in plant.chains.masses],
            "inside_drive": bool(rng.uniform() < 0.7),
            "duration_s": clock,
        },
    )


def without_periods(rng: np.random.Generator, setup: Setup, excitation: str) -> Setup:
    """The same plan shaken from rest by a sweep, noise or stepped sines of each run's band and peaks."""
    runs = [_without_period(rng, setup, run, excitation) if run.period else run for run in setup.runs]
    return replace(setup, runs=tuple(runs), settings={**setup.settings, "excitation": excitation})


def _without_period(rng: np.random.Generator, setup: Setup, run: Run, excitation: str) -> Run:
    rows, rate = run.length * setup.sub, setup.rate * setup.sub
    low, high = run.lines_hz[0], run.lines_hz[-1]
    share = np.arange(rows) / rows
    phase = rng.uniform(0, 2 * np.pi, setup.plant.count)
    if excitation == "noise":
        hz = rng.uniform(low, high, (60, setup.plant.count))
        turns = np.outer(share * rows / rate, np.ones(setup.plant.count))
        wave = sum(f**-0.5 * np.sin(2 * np.pi * f * turns + phase * k) for k, f in enumerate(hz))
    else:
        share = np.floor(24 * share) / 23 if excitation == "stepped" else share
        turns = np.cumsum(low * (high / low) ** share) / rate
        wave = np.sin(2 * np.pi * turns[:, None] + phase)
    wave = (
        wave * np.minimum(1.0, np.minimum(np.arange(rows), rows - np.arange(rows)) / (0.03 * rows))[:, None]
    )
    if setup.staircase:
        wave = np.repeat(wave[:: setup.sub], setup.sub, axis=0)
    peak = np.abs(run.excitation).max(axis=0)
    return replace(
        run,
        kind=Kind.CHIRP if excitation == "chirp" else Kind.OTHER,
        excitation=wave / np.abs(wave).max(axis=0) * peak,
        settle=0, periods=1, period=0, lines_hz=np.zeros(0),
    )  # fmt: skip
