"""``invid simulate`` as a user runs it."""

import json
from pathlib import Path

import numpy as np
import pytest

from invid.cli.app import run
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, Model, save_model
from invid.recording import Experiment, Kind, Recording, Role, read_recording, write_recording


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path, Path]:
    """A single free mass pushed by a sine, its exact motion, its model."""
    chains = CoupledChains.build([[2.0]], [[]])
    time = np.arange(2000) / 500.0
    omega = 2 * np.pi * 2.0
    experiment = Experiment(
        "000",
        Kind.MULTISINE,
        Role.VALIDATE,
        0,
        np.zeros(1),
        250,
        np.array([2.0]),
        500.0,
        time,
        -0.3 / (2.0 * omega**2) * np.sin(omega * time)[:, None],
        0.3 * np.sin(omega * time)[:, None],
    )
    rec, mod = tmp_path / "rec.h5", tmp_path / "model.json"
    write_recording(Recording("r", ("A1",), "rad", "N·m", "2026-01-01T00:00:00Z", (experiment,)), rec)
    save_model(Model("r", "test", chains, ChainStd.unknown(chains)), mod)
    return mod, rec, tmp_path / "sim.h5"


def test_the_answer_is_written_as_a_recording_and_summed_up_in_one_json_document(
    files: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    model, recording, output = files
    assert run(["simulate", str(model), str(recording), "-o", str(output), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    error = document["experiments"][0]["position_error"][0]
    assert error["axis"] == "A1"
    assert error["relative"] < 1e-3
    answer = read_recording(output)
    measured = read_recording(recording)
    assert answer.experiments[0].kind is Kind.MULTISINE
    assert answer.experiments[0].role is Role.VALIDATE
    assert answer.experiments[0].period_samples == 250
    np.testing.assert_allclose(
        answer.experiments[0].position, measured.experiments[0].position, atol=1e-3 * 0.001
    )


def test_a_model_that_does_not_describe_the_record_ends_with_status_3(
    files: tuple[Path, Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    model, recording, output = files
    chains = CoupledChains.build([[0.2]], [[]])
    save_model(Model("r", "test", chains, ChainStd.unknown(chains)), model)
    assert run(["simulate", str(model), str(recording), "-o", str(output), "--json"]) == 3
    assert "times the measured motion" in json.loads(capsys.readouterr().out)["warnings"][0]
