"""What an encoder errs by within the periods of its scale is taken out; motion is left alone."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hidden.generator import make

from invid.numerics.arrays import Float64
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.signals.encoder_interpolation import remove_interpolation_error

RATE, COUNT = 500.0, 6000
TIME = np.arange(COUNT) / RATE
STEP = 2 * np.pi / 2**19


def motion() -> Float64:
    """A motion of a tenth of a radian with speeds up to one and a half radians a second."""
    out: Float64 = 0.1 * np.sin(2 * np.pi * 0.7 * TIME) + 0.06 * np.sin(2 * np.pi * 2.3 * TIME + 1.0)
    return out


def recording(position: Float64) -> Recording:
    """One axis, read by an encoder of 19 bits."""
    e = Experiment(
        "000", Kind.MULTISINE, Role.IDENTIFY, 0, np.zeros(1), 0, np.array([0.7, 2.3]), RATE, TIME,
        STEP * np.round(position[:, None] / STEP), np.zeros((COUNT, 1)),
    )  # fmt: skip
    return Recording("robot", ("J1",), "rad", "N·m", "2026-01-01", (e,))


@pytest.mark.parametrize("lines", [512.0, 2048.0, 700.5])
def test_an_error_of_one_and_two_cycles_a_line_is_taken_out(lines: float) -> None:
    true = motion()
    error = 1.2 * STEP * np.sin(lines * true + 0.3) + 0.5 * STEP * np.cos(2 * lines * true)
    corrected, notes = remove_interpolation_error(recording(true + error))
    left = corrected.experiments[0].position[:, 0] - true
    assert np.std(left) < 0.4 * STEP < 0.5 * np.std(error)
    assert len(notes) == 1
    told = re.findall(r"([\d.]+) times a turn", notes[0])
    assert min(float(n) for n in told) == pytest.approx(lines, rel=1e-3)


@pytest.mark.parametrize("cause", [None, "cogging", "coulomb_friction", "transmission_error"])
def test_a_machine_without_such_an_error_is_left_as_it_is(cause: str | None) -> None:
    measured, _ = make(cause, seed=11, target_db=None if cause is None else 20, motors=1)
    assert remove_interpolation_error(measured)[1] == []


@pytest.mark.parametrize("crest", ["low", "random"])
def test_fast_motion_is_no_error_of_its_encoder(crest: str) -> None:
    """Lines up to a third of the sampling rate, none declared: what is fast is the motion itself, and a wave
    over a way that it hardly fills looks like it."""
    lines = np.arange(10, 2000)
    phase = np.pi * lines**2 / lines.size  # Schroeder
    if crest == "random":
        phase = np.random.default_rng(4).uniform(0, 2 * np.pi, lines.size)
    bins = np.zeros(COUNT // 2 + 1, complex)
    bins[lines] = np.exp(1j * phase)
    wave = np.fft.irfft(bins)
    measured = recording(0.1 * wave / wave.std())
    (e,) = measured.experiments
    undeclared = replace(measured, experiments=(replace(e, frequencies_hz=np.zeros(0)),))
    assert remove_interpolation_error(undeclared) == (undeclared, [])
