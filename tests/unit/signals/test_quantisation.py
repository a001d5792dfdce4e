"""Rounding of a motion of few counts: where its power lies, and that it is no finding."""

from __future__ import annotations

import numpy as np
import pytest

from invid.signals.noise import rounding_power

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
