"""Rounding of a motion of few counts: where its power lies, and that it is no finding."""

from __future__ import annotations

import numpy as np
import pytest

from invid.recording.model import Experiment, Role
from invid.signals.noise import rounding_power
from invid.signals.record import make_record

PERIOD = 8000


def lines_of(values: np.ndarray) -> np.ndarray:
    """(P, L, 1) one-sided amplitudes of lines 1…L of each period."""
    folded = values.reshape(-1, PERIOD)
    return (np.fft.rfft(folded, axis=1)[:, 1 : PERIOD // 2] * (2 / PERIOD))[..., None]


def slow_motion(counts: float, rng: np.random.Generator, periods: int = 2) -> np.ndarray:
    """A multisine of lines 1…200, falling with frequency as motions do, of rms ``counts``, repeated."""
    t = np.arange(PERIOD) / PERIOD
    k = np.arange(1, 201)
    wave = (np.cos(2 * np.pi * k[:, None] * t + rng.uniform(0, 2 * np.pi, (200, 1))) / k[:, None]).sum(axis=0)
    return np.tile(wave * counts / wave.std(), periods) + rng.uniform()


@pytest.mark.parametrize("counts", [1.0, 2.0, 5.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_power_within_the_band_is_that_of_the_true_rounding(counts: float, seed: int) -> None:
    true = slow_motion(counts, np.random.default_rng(seed))
    seen = lines_of(np.round(true))
    error = lines_of(np.round(true) - true).mean(axis=0)[:300]
    power = np.abs(seen) ** 2
    found = rounding_power(power.mean(axis=0), np.abs(seen.mean(axis=0)) ** 2, np.ones(1), 300)
    assert found.sum() == pytest.approx((np.abs(error) ** 2).sum(), rel=0.35)
    assert found.sum() > 3.0 * 300 * 4 / 12 / PERIOD  # the white share, which was assumed before


def test_the_rounding_of_a_symmetric_motion_lies_on_odd_lines() -> None:
    rng = np.random.default_rng(6)
    t = np.arange(PERIOD) / PERIOD
    k = np.arange(1, 201, 2)
    wave = np.cos(2 * np.pi * k[:, None] * t + rng.uniform(0, 2 * np.pi, (100, 1))).sum(axis=0)
    wave *= 2.0 / wave.std()
    seen = lines_of(np.tile(np.round(wave), 2))
    power = np.abs(seen) ** 2
    found = rounding_power(power.mean(axis=0), np.abs(seen.mean(axis=0)) ** 2, np.ones(1), 300)[:, 0]
    assert found[1::2].sum() < 1e-6 * found[0::2].sum()


@pytest.mark.parametrize("counts", [30.0, 300.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_record_of_odd_lines_has_the_noise_of_its_odd_lines(counts: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    t, k, count = np.arange(PERIOD) / PERIOD, np.arange(3, 101, 2), 1e-5
    wave = (np.cos(2 * np.pi * k[:, None] * t + rng.uniform(0, 2 * np.pi, (49, 1))) / k[:, None]).sum(axis=0)
    kinks = np.arange(401, 491, 2)[:, None]  # faster than motion is smoothed
    fast = np.cos(2 * np.pi * kinks * t + rng.uniform(0, 2 * np.pi, kinks.shape)).sum(axis=0)
    true = np.tile(wave * counts * count / wave.std() + count * fast / fast.std(), 4)[:, None]
    read = np.round(true / count) * count
    torque = np.tile(np.cos(2 * np.pi * 3 * t), 4)[:, None] + 0.01 * rng.standard_normal(true.shape)
    experiment = Experiment(
        key="0",
        kind="multisine",
        role=Role.IDENTIFY,
        hold_gain=np.zeros(1),
        sample_rate_hz=1000.0,
        time=np.arange(true.shape[0]) / 1000.0,
        position=read,
        torque=torque,
        excited_axis=0,
        period_samples=PERIOD,
        frequencies_hz=k / 8.0,
    )
    record = make_record(experiment, np.array([count]))
    error = np.fft.rfft(read - true, axis=0)[4 * k] * 2.0 / true.shape[0]
    ratio = record.position_noise / (np.abs(error) ** 2).mean()
    assert ratio == pytest.approx(1.0, rel=0.3)
