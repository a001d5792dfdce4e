"""Readings that no motion explains are taken out and said; motion of every other kind is left alone."""

import numpy as np
import pytest

from invid.recording.model import Experiment, Kind, Recording, Role
from invid.signals.encoder_glitches import remove_glitches

RATE, COUNT = 1000.0, 4000
TIME = np.arange(COUNT) / RATE
RESOLUTION = 2 * np.pi / 2**18


def recording(
    position: np.ndarray, *, time: np.ndarray = TIME, torque: np.ndarray | None = None
) -> Recording:
    """One axis, read by an encoder of 18 bits."""
    read = RESOLUTION * np.round(position[:, None] / RESOLUTION)
    if torque is None:
        torque = np.random.default_rng(5).normal(size=time.size)
    e = Experiment(
        "000",
        Kind.MULTISINE,
        Role.IDENTIFY,
        0,
        np.zeros(1),
        0,
        np.zeros(0),
        RATE,
        time,
        read,
        torque[:, None],
    )
    return Recording("r", ("A1",), "rad", "N·m", "2026-11-22T00:00:00Z", (e,))


def shaken(lowest: float = 3.0, highest: float = 100.0) -> np.ndarray:
    """(n,) a motion of 10 mrad rms, as a chain under a multisine makes: less, the faster."""
    rng = np.random.default_rng(1)
    lines = np.arange(lowest, highest, 1.7)
    waves = np.sin(2 * np.pi * np.outer(TIME, lines) + rng.uniform(0, 2 * np.pi, lines.size)) / lines**2
    motion: np.ndarray = waves.sum(axis=1)
    return 0.01 * motion / motion.std()


def test_samples_that_stand_off_are_interpolated_and_said() -> None:
    motion = shaken()
    rng = np.random.default_rng(2)
    at = rng.choice(COUNT, 20, replace=False)
    read = motion.copy()
    read[at] += rng.choice([-1, 1], 20) * 10 ** rng.uniform(-2.5, 0.5, 20)
    sound, said = remove_glitches(recording(read))
    assert len(said) == 1
    assert "20 samples stand off in the position of axis A1" in said[0]
    assert np.abs(sound.experiments[0].position[:, 0] - motion).max() < 5 * RESOLUTION


@pytest.mark.parametrize("size", [0.02, -3.0])
def test_counts_that_are_lost_are_given_back(size: float) -> None:
    motion = shaken()
    read = motion.copy()
    read[1234:] += size
    read[2345:] += 0.7 * size
    sound, said = remove_glitches(recording(read))
    assert len(said) == 1
    assert "jumps 2 times" in said[0]
    assert np.abs(sound.experiments[0].position[:, 0] - motion).max() < 8 * RESOLUTION


def test_an_angle_that_wraps_is_unwrapped_even_where_it_dithers_about_the_seam() -> None:
    turning = shaken() + 4.0 * TIME
    about = 0.001 * np.sin(40 * TIME)
    for motion in (turning, about):
        wrapped = np.mod(RESOLUTION * np.round(motion / RESOLUTION), 2 * np.pi)
        sound, said = remove_glitches(recording(wrapped))
        assert len(said) == 1
        off = sound.experiments[0].position[:, 0] - motion
        assert np.ptp(off) < 2 * RESOLUTION


def knocked() -> np.ndarray:
    """A speed that changes at once by 0.5 rad/s, ten times."""
    at, speed = np.linspace(0.2, 3.7, 10), 0.5 * np.resize([1.0, -1.0], 10)
    motion: np.ndarray = shaken() + np.maximum(TIME[:, None] - at, 0.0) @ speed
    return motion


def sticking() -> np.ndarray:
    """Rest, a slip of 15 counts, rest."""
    return 15 * RESOLUTION * (TIME > 1.0)


MOTIONS = {
    "nothing": np.zeros(COUNT),
    "a multisine": shaken(),
    "fast lines": shaken(50.0, 300.0),
    "knocks": knocked(),
    "a slip": sticking(),
    "a ramp that reverses": 0.3 * np.abs(TIME - 2.0),
    "a move from rest": np.where(TIME > 2.0, (TIME - 2.0) ** 2, 0.0),
    "a burst": np.where((TIME > 2.0) & (TIME < 2.05), 0.01 * np.sin(2 * np.pi * 60 * (TIME - 2.0)), 0.0),
}


@pytest.mark.parametrize("name", MOTIONS)
def test_motion_is_left_alone(name: str) -> None:
    given = recording(MOTIONS[name])
    assert remove_glitches(given) == (given, [])
