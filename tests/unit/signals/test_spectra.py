"""Spectra: what is averaged, what is dropped, and what noise is found."""

from __future__ import annotations

import numpy as np
import pytest

from invid.recording.model import Experiment, Kind, Role
from invid.signals.spectra import spectra_of

RATE = 1000.0


def experiment(
    position: np.ndarray,
    torque: np.ndarray,
    *,
    time: np.ndarray | None = None,
    period: int = 1000,
    lines: tuple[float, ...] = (5.0, 11.0, 23.0),
    demand: np.ndarray | None = None,
    kind: Kind = Kind.MULTISINE,
) -> Experiment:
    n, m = position.shape
    return Experiment(
        key="000",
        kind=kind,
        role=Role.IDENTIFY,
        excited_axis=0,
        hold_gain=np.zeros(m),
        period_samples=period,
        frequencies_hz=np.array(lines),
        sample_rate_hz=RATE,
        time=np.arange(n) / RATE if time is None else time,
        position=position,
        torque=torque,
        torque_demand=demand,
    )


def tones(time: np.ndarray, lines: tuple[float, ...] = (5.0, 11.0, 23.0)) -> np.ndarray:
    """Sum of cosines of amplitude 1, 2, 3 and phase 0.3, 0.6, 0.9."""
    return sum((k + 1) * np.cos(2 * np.pi * f * time + 0.3 * (k + 1)) for k, f in enumerate(lines))


def expected() -> np.ndarray:
    return np.array([(k + 1) * np.exp(0.3j * (k + 1)) for k in range(3)])


def test_the_amplitude_of_a_sinusoid_is_the_modulus_of_its_line() -> None:
    t = np.arange(4000) / RATE
    wave = tones(t)[:, None]
    s = spectra_of(experiment(0.01 * wave, wave))
    assert s.periods == 4
    assert s.frequency_hz[s.excited] == pytest.approx([5, 11, 23])
    assert s.torque[s.excited, 0] == pytest.approx(expected(), rel=1e-9)
    assert s.position[s.excited, 0] == pytest.approx(0.01 * expected(), rel=1e-9)


def test_jittered_sync_instants_do_not_bias_the_lines() -> None:
    n = 4000
    # A third of a sample, swinging at 6 Hz: uncorrected it moves 5 Hz onto 11 Hz, 2.5e-3 of it.
    time = (np.arange(n) + 0.3 * np.sin(2 * np.pi * 6 * np.arange(n) / RATE)) / RATE
    wave = tones(time)[:, None]
    s = spectra_of(experiment(wave, wave, time=time))
    assert s.torque[s.excited, 0] == pytest.approx(expected(), rel=3e-4)
    untouched = spectra_of(experiment(wave, wave))
    assert np.abs(untouched.torque[untouched.excited, 0] - expected()).max() > 3e-3


def test_lost_samples_are_interpolated_and_said() -> None:
    rng = np.random.default_rng(2)
    keep = np.sort(rng.permutation(np.arange(1, 3999))[:3900])
    time = np.concatenate(([0], keep, [3999])) / RATE
    wave = tones(time)[:, None]
    s = spectra_of(experiment(wave, wave, time=time))
    assert any("missing" in w for w in s.warnings)
    assert s.torque[s.excited, 0] == pytest.approx(expected(), rel=1e-3)


def test_a_decaying_transient_is_left_out_of_the_average() -> None:
    rng = np.random.default_rng(3)
    n = 6000
    t = np.arange(n) / RATE
    wave = tones(t) + 5.0 * np.exp(-t / 0.15) * np.cos(2 * np.pi * 8.3 * t)
    noisy = wave[:, None] + 1e-3 * rng.standard_normal((n, 1))
    s = spectra_of(experiment(noisy, noisy))
    assert s.periods < 6
    assert s.torque[s.excited, 0] == pytest.approx(expected(), rel=3e-3)


def test_the_covariance_of_the_mean_is_that_of_white_noise() -> None:
    rng = np.random.default_rng(4)
    n, sigma = 5000, 0.2
    clean = tones(np.arange(n) / RATE)[:, None]
    s = spectra_of(
        experiment(
            clean + sigma * rng.standard_normal((n, 1)), clean + 2 * sigma * rng.standard_normal((n, 1))
        )
    )
    power = np.einsum("fcc->fc", s.covariance).real.mean(axis=0)
    # A line of a white record of variance σ² has power 4σ²/n.
    assert power == pytest.approx([4 * sigma**2 / n, 16 * sigma**2 / n], rel=0.25)
    assert s.floor == pytest.approx([4 * sigma**2 / n, 16 * sigma**2 / n], rel=0.5)


def test_a_wrong_declared_period_is_found_out_and_the_right_one_used() -> None:
    rng = np.random.default_rng(5)
    n = 4000
    wave = tones(np.arange(n) / RATE)[:, None] + 0.01 * rng.standard_normal((n, 1))
    s = spectra_of(experiment(wave, wave, period=930))
    assert any("does not repeat" in w and "1000" in w for w in s.warnings)
    assert s.torque[s.excited, 0] == pytest.approx(expected(), rel=0.01)


def test_few_lines_of_an_odd_multisine_are_told_from_what_a_machine_makes_between_them() -> None:
    """None declared: the lines between held distortion far above the noise, and were taken for excited."""
    rng = np.random.default_rng(2)
    period, periods = 4000, 4
    lines = np.sort(rng.choice(np.arange(5, 1000, 2), 200, replace=False))
    bins = np.zeros(period // 2 + 1, complex)
    bins[lines] = np.exp(2j * np.pi * rng.random(lines.size)) * lines**-0.5
    wave = np.fft.irfft(bins) / np.fft.irfft(bins).std()
    speed = np.gradient(wave)
    torque = np.tile(wave - 0.03 * np.sign(speed) + 0.02 * wave**2, periods)[:, None]
    torque += 1e-3 * rng.standard_normal(torque.shape)
    found = spectra_of(experiment(1e-3 * torque, torque, period=period, lines=()))
    told = np.round(found.frequency_hz[found.excited] * period / RATE).astype(int)
    assert np.isin(told, lines).mean() > 0.97
    assert told.size >= lines.size - 3  # the last thousandth of the power
