"""The bootstrap says what the covariance says where the fit is nearly linear, on any number of cores."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from two_masses import held, recording

from invid.cli.app import run
from invid.identification.identify import identify
from invid.recording import Role, write_recording
from invid.recording.model import Experiment, Kind, Recording

STEP, PERIOD = 0.002, 1024
LINES = np.arange(1, 60)


@pytest.fixture(scope="module")
def measured() -> Recording:
    rng = np.random.default_rng(5)
    bins = np.zeros(PERIOD // 2 + 1, complex)
    bins[LINES] = np.exp(2j * np.pi * rng.random(LINES.size)) * PERIOD / 2
    push = np.tile(np.fft.irfft(bins), 12)
    position, torque = held(push, STEP, 60.0, 6.0)
    kept = slice(8 * PERIOD, None)
    return recording(
        Experiment(
            key="000",
            kind=Kind.MULTISINE,
            role=Role.IDENTIFY,
            excited_axis=0,
            hold_gain=np.array([60.0]),
            period_samples=PERIOD,
            frequencies_hz=LINES / (PERIOD * STEP),
            sample_rate_hz=1.0 / STEP,
            time=np.arange(4 * PERIOD) * STEP,
            position=(position + 1e-6 * rng.standard_normal(push.size))[kept, None],
            torque=(torque + 0.05 * rng.standard_normal(push.size))[kept, None],
            torque_demand=torque[kept, None],
        )
    )


def test_spreads_are_those_of_the_covariance_and_the_same_on_two_cores(measured: Recording) -> None:
    one = identify(measured, bootstrap=60)
    two = identify(measured, bootstrap=60, workers=2)
    assert one.fit["bootstrap"] == two.fit["bootstrap"]
    spreads = one.fit["bootstrap"]["parameters"]
    stated = {"A1.mass.1": one.std.masses[0][0], "A1.mass.2": one.std.masses[0][1]}
    stated["A1.spring.1"] = one.std.springs[0][0]
    values = {"A1.mass.1": one.chains.masses[0][0], "A1.mass.2": one.chains.masses[0][1]}
    values["A1.spring.1"] = one.chains.springs[0][0]
    for name, std in stated.items():
        # A spread of 60 draws is known to 9 %.
        assert spreads[name]["std"] == pytest.approx(std, rel=0.35)
        assert abs(spreads[name]["bias"]) < 4.0 * std / np.sqrt(60)
        assert spreads[name]["low"] < values[name] < spreads[name]["high"]


def test_the_command_prints_it_and_refuses_what_it_cannot_do(
    measured: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "rec.h5"
    write_recording(measured, path)
    assert run(["identify", str(path), "--bootstrap", "20", "--json"]) in (0, 3)
    found = json.loads(capsys.readouterr().out)
    assert found["fit"]["bootstrap"]["draws"] == 20
    assert run(["identify", str(path), "--bootstrap", "20"]) in (0, 3)
    assert "bootstrap ±" in capsys.readouterr().out
    assert run(["identify", str(path), "--bootstrap", "5"]) == 2
    assert "20 or more" in capsys.readouterr().err
    assert run(["identify", str(path), "--bootstrap", "20", "--method", "paper"]) == 2
