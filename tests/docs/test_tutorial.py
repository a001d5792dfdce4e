"""The tutorial's own commands, run on the measured bench, and its claims held against the load encoder."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from invid.cli.app import run
from invid.forward import antiresonances, resonances
from invid.model import Model, load_model
from invid.recording import read_recording

ROOT = Path(__file__).resolve().parents[2]
TUTORIAL = ROOT / "docs" / "tutorial" / "flexible-drive.md"
DATA = ROOT.parent / "shared" / "data"
RAW = DATA / "flexible_drive" / "MultisineTypeB.mat"
PERIOD = 2500  # samples of one second: the line of index k is k Hz


def commands() -> list[list[str]]:
    """The words of every command in the tutorial's shell blocks, with absolute paths."""
    blocks = re.findall(r"```sh\n(.*?)```", TUTORIAL.read_text(encoding="utf-8"), flags=re.DOTALL)
    lines = [line for block in blocks for line in block.splitlines() if line.strip()]
    return [
        [
            re.sub(r"^configs/", f"{ROOT}/configs/", re.sub(r"^\.\./shared/data", str(DATA), word))
            for word in shlex.split(line)
        ]
        for line in lines
    ]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder in which all commands of the tutorial were run."""
    if not RAW.exists():
        reason = f"the measured bench is not there ({RAW}): the tutorial is NOT checked"
        print(reason)
        pytest.skip(reason)
    where = tmp_path_factory.mktemp("tutorial")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(where)
        for words in commands():
            assert words[0] == "invid"
            status = run(words[1:])
            # 3: done, with warnings, which the tutorial shows and explains.
            assert status in (0, 3), (words, status)
    return where


@pytest.fixture(scope="module")
def model(folder) -> Model:
    return load_model(folder / "model.json")


def test_the_tutorial_shows_the_four_steps():
    assert [words[1] for words in commands()] == ["import", "identify", "simulate", "diagnose"]


def test_the_recording_never_saw_the_load_encoder(folder):
    recording = read_recording(folder / "bench.h5")
    assert recording.axes == ("motor",)
    load = scipy.io.loadmat(RAW, squeeze_me=True)["theta_my"]
    first = recording.experiments[0].position[:, 0]
    assert np.abs(np.corrcoef(first, load[PERIOD : PERIOD + first.size])[0, 1]) < 0.99


def test_antiresonance_and_resonance_from_the_motor_side_alone(model):
    assert antiresonances(model.chains, 0)[0] / (2 * np.pi) == pytest.approx(54.03, abs=0.5)
    assert resonances(model.chains)[1] / (2 * np.pi) == pytest.approx(76.36, abs=0.5)


def load_frf_error(model: Model, *, friction: bool = True) -> float:
    """Relative error of the FRF from measured current to load angle, below 150 Hz.

    Measured: the load encoder (sign reversed) over the current, at the excited lines of the averaged
    periods 2 to 20. Model: K + jω(C + viscous friction) − ω²M inverted, motor to load, times the time
    offset that the identification found between torque and position. Coulomb friction has no FRF and
    is left out.
    """
    content = scipy.io.loadmat(RAW, squeeze_me=True)
    lines = np.arange(13, 150, 4)

    def spectrum(name: str) -> np.ndarray:
        periods = np.asarray(content[name], dtype=float)[PERIOD:].reshape(-1, PERIOD)
        return np.fft.rfft(periods.mean(axis=0))[lines]

    measured = -spectrum("theta_my") / spectrum("iq_adx")
    chains = model.chains
    damping = np.array(chains.damping_matrix)
    for effect in model.effects if friction else ():
        if effect.cause == "viscous_friction":
            mass = int((effect.element or "mass 1").split()[1]) - 1
            damping[mass, mass] += effect.value("coefficient")
    offsets = model.fit.get("time_offset_s", {})
    delay = sum(float(o["value"]) for o in offsets.values())
    omega = 2 * np.pi * lines
    stiffness = (
        chains.stiffness_matrix
        + 1j * omega[:, None, None] * damping
        - omega[:, None, None] ** 2 * chains.mass_matrix
    )
    predicted = np.linalg.inv(stiffness)[:, -1, 0] * np.exp(-1j * omega * delay)
    return float(np.linalg.norm(predicted - measured) / np.linalg.norm(measured))


def test_the_load_moves_as_the_model_says_it_does(model):
    error = load_frf_error(model)
    print(f"held-out load FRF error below 150 Hz: {100 * error:.2f} %")
    assert error < 0.08


def test_the_load_check_can_tell_a_wrong_model(model):
    assert load_frf_error(model, friction=False) > 0.3


def test_the_simulated_motor_follows_periods_that_were_kept_out(folder):
    measured = read_recording(folder / "bench.h5").experiments[1].position[:, 0]
    simulated = read_recording(folder / "simulated.h5").experiments[1].position[:, 0]
    assert np.std(simulated - measured) < 0.1 * np.std(measured)


def test_diagnosis_and_report_are_written(folder):
    assert (folder / "diagnosis.json").stat().st_size > 0
    assert "<html" in (folder / "report.html").read_text(encoding="utf-8").lower()
