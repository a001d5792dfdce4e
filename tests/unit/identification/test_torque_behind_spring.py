"""A torque measured behind the spring moves everything but the motor: that is said, and no motor is sure."""

import numpy as np
import pytest

import invid
from invid.model.doubts import DoubtCode, doubts_of
from invid.recording.model import Experiment, Kind, Recording, Role

STEP, PERIOD, PERIODS, LINES = 1e-3, 4096, 2, np.arange(1, 120)
MOTOR, LOAD, SPRING, DAMPER, DRAG = 0.7, 2.0, 1000.0, 0.6, 0.5


@pytest.mark.parametrize("is_behind", [True, False])
def test_a_torque_behind_the_spring_is_told_from_the_motors_own(is_behind: bool) -> None:
    found = doubts_of(invid.identify(_shaken(is_behind=is_behind)).fit)
    assert (DoubtCode.TORQUE_BEHIND_SPRING in [d.code for d in found]) is is_behind


def _shaken(*, is_behind: bool) -> Recording:
    """Two masses shaken by the motor's torque, on lines: steady state, and sensors with noise."""
    rng = np.random.default_rng(7)
    omega = 2 * np.pi * LINES / (PERIOD * STEP)
    s = 1j * omega
    link = SPRING + DAMPER * s
    load = LOAD * s**2 + DRAG * s
    behind = link * load / (link + load)
    position = np.exp(1j * rng.uniform(0, 2 * np.pi, omega.size)) * 0.02 / omega
    torque = (behind if is_behind else behind + MOTOR * s**2) * position
    # A torque that is held over the sample acts half a sample late, as the product expects it.
    waves = []
    for lines, noise in ((position, 1e-7), (torque, 1e-4 * np.abs(torque).max())):
        spectrum = np.zeros(PERIOD // 2 + 1, dtype=complex)
        spectrum[LINES] = lines * PERIOD / 2
        wave = np.tile(np.fft.irfft(spectrum, PERIOD), PERIODS)
        waves.append((wave + noise * rng.standard_normal(wave.size))[:, None])
    time = np.arange(PERIOD * PERIODS) * STEP
    first = Experiment(
        "000",
        Kind.MULTISINE,
        Role.IDENTIFY,
        0,
        np.zeros(1),
        PERIOD,
        LINES / (PERIOD * STEP),
        1.0 / STEP,
        time,
        waves[0],
        waves[1],
    )
    return Recording("bench", ("A1",), "rad", "N·m", "2026-01-01T00:00:00+00:00", (first,), (2,))
