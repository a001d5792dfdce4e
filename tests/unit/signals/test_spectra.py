"""Spectra: what is averaged, what is dropped, and what noise is found."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest

from invid.errors import RecordingError
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.signals.frf import frf_matrix
from invid.signals.noise import quantisation_step, repeating_power
from invid.signals.periods import find_period
from invid.signals.spectra import all_spectra, spectra_of

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


def test_settled_periods_are_all_kept() -> None:
    kept = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        n = 5000
        wave = tones(np.arange(n) / RATE)[:, None] + 0.05 * rng.standard_normal((n, 1))
        s = spectra_of(experiment(wave, wave))
        kept += s.periods == 5 and not s.transient
    assert kept == 20


def test_a_coasting_axis_does_not_leak_onto_the_lines() -> None:
    t = np.arange(4000) / RATE
    wave = tones(t)[:, None]
    s = spectra_of(experiment(wave + 3.0 * t[:, None], wave))
    assert s.position[s.excited, 0] == pytest.approx(expected(), rel=1e-6)


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


def test_a_record_that_never_repeats_is_taken_whole() -> None:
    rng = np.random.default_rng(6)
    wave = np.cumsum(rng.standard_normal((4000, 1)), axis=0)
    s = spectra_of(experiment(wave, wave, period=900, lines=(), kind=Kind.OTHER))
    assert s.transient
    assert s.periods == 1


def test_a_torque_that_repeats_the_demand_is_known_to_be_held_over_the_sample() -> None:
    rng = np.random.default_rng(7)
    demand = tones(np.arange(3000) / RATE)[:, None]
    torque = np.vstack((demand[:1], demand[:-1])) + 0.01 * rng.standard_normal(demand.shape)
    assert spectra_of(experiment(demand, torque, demand=demand)).staircase[0] == 1.0
    assert np.isnan(spectra_of(experiment(demand, torque)).staircase[0])


def test_the_step_of_a_quantised_channel_is_found_and_a_continuous_one_has_none() -> None:
    rng = np.random.default_rng(8)
    values = rng.standard_normal((5000, 2))
    values[:, 0] = np.round(values[:, 0] / 0.013) * 0.013
    assert quantisation_step(values) == pytest.approx([0.013, 0.0], rel=1e-6)


def test_the_period_of_a_periodic_wave_is_found() -> None:
    t = np.arange(5000) / RATE
    assert find_period(tones(t), 2500) == 1000


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(RecordingError, match="too few"):
        spectra_of(experiment(np.zeros((3, 1)), np.zeros((3, 1))))


def test_the_frf_of_two_axes_needs_two_experiments_that_differ() -> None:
    t = np.arange(3000) / RATE
    one = tones(t)
    g = np.array([[2.0, 0.5], [0.5, 1.0]])
    first = np.stack((one, 0.2 * one), axis=1)
    second = np.stack((0.1 * one, np.roll(one, 37)), axis=1)
    records = [spectra_of(experiment(x @ g.T, x)) for x in (first, second)]
    measured = frf_matrix(records)
    assert measured.frequency_hz == pytest.approx([5, 11, 23])
    assert np.abs(measured.frf - g).max() < 1e-9
    assert frf_matrix(records[:1]).frequency_hz.size == 0


def test_spectra_are_kept_as_long_as_their_experiment_and_no_other_one_gets_them() -> None:
    one = experiment(tones(np.arange(3000) / RATE)[:, None], tones(np.arange(3000) / RATE)[:, None])
    recording = Recording("r", ("A1",), "rad", "N·m", "2026-11-24T00:00:00Z", (one,))
    (first,) = all_spectra(recording)
    assert all_spectra(recording)[0] is first
    other = replace(recording, experiments=(replace(one, torque=2.0 * one.torque),))
    assert np.abs(all_spectra(other)[0].torque).max() == pytest.approx(2.0 * np.abs(first.torque).max())
    gone = weakref.ref(one)
    del one, recording, other
    gc.collect()
    assert gone() is None


def test_rounding_that_repeats_on_odd_lines_is_seen_beneath_what_a_transient_leaks() -> None:
    """Between the lines of the period there is four times less, and noise was read there: records that still
    settle had theirs up to 4.5 times too small."""
    rng = np.random.default_rng(3)
    lines = np.arange(1, 4001)
    noise = rng.standard_normal((lines.size, 2)) @ np.array([1.0, 1.0j]) * np.where(lines % 2, 1.0, 0.5)
    leak = 3e4 / (1j * lines) - 2e5 / (lines**2 - 9e4 + 3e2j * lines)  # an end that does not close, a mode
    assert repeating_power(noise + leak, lines > 500) == pytest.approx(2.0, rel=0.15)


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


def test_all_lines_of_a_random_torque_are_excited() -> None:
    rng = np.random.default_rng(2)
    bins = np.fft.rfft(rng.standard_normal(4000))
    bins[1000:] = 0.0
    torque = np.tile(np.fft.irfft(bins), 4)[:, None]
    torque += 1e-3 * rng.standard_normal(torque.shape)
    found = spectra_of(experiment(1e-3 * torque, torque, period=4000, lines=()))
    assert found.excited[:999].mean() > 0.95
