"""Torque that follows the noise of its own axis' reading is no sensor's noise."""

from __future__ import annotations

import numpy as np
import pytest

from invid.signals.noise import sensor_noise_share

STEP, PERIOD, PERIODS = 1e-3, 2000, 4
HZ = np.arange(1, PERIOD // 2) / (PERIOD * STEP)
QUIET = (HZ > 100.0) & (HZ < 450.0)


def _lines(wave: np.ndarray) -> np.ndarray:
    folded = wave.reshape(PERIODS, PERIOD, -1)
    return (np.fft.rfft(folded, axis=1) * 2 / PERIOD)[:, 1:-1][:, QUIET]


def _share(late: int, sensor: float, *, signal: float = 0.0) -> float:
    """A hold of 100 N·m/rad and 3 N·m·s/rad on a reading with noise of 1e-5 rad."""
    rng = np.random.default_rng(7)
    n = PERIOD * PERIODS
    reading = 1e-5 * rng.standard_normal((n + 8, 1))
    command = -100.0 * reading - 3.0 / STEP * np.diff(reading, axis=0, prepend=0.0)
    torque = np.roll(command, late, axis=0)[8:] + sensor * rng.standard_normal((n, 1))
    wave = np.concatenate((reading[8:], torque), axis=1)
    # A harmonic that the machine answers, among the quiet lines.
    wave += signal * np.sin(2 * np.pi * 150.0 * STEP * np.arange(n))[:, None] * np.array([1e-4, 5.0])
    position, own = sensor_noise_share(_lines(wave), HZ[QUIET], STEP)
    assert position == 1.0
    return float(own)


@pytest.mark.parametrize("late", [0, 1, 3])
def test_what_a_loop_makes_of_its_reading_is_taken_off_and_the_sensors_noise_stays(late: int) -> None:
    chatter = 1e-5 * np.hypot(100.0, np.sqrt(2.0) * 3.0 / STEP)
    # Periods are cut where they end, and the loop reads beyond: some samples in two thousand.
    assert _share(late, 0.0) < 3e-3
    assert _share(late, 0.1 * chatter) == pytest.approx(0.01, abs=4e-3)
