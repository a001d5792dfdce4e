"""A diagnosis that cannot tell, the experiment it asks for on the same cell, the answer: all by commands."""

import json
from pathlib import Path

import numpy as np
import pytest

from invid.cli.app import run
from invid.recording import read_recording

pytestmark = pytest.mark.campaign

LATE = 0.004
CELL = f"""
format: invid-config
format_version: 1
robot: one axis whose torque acts late
motion: rotary
bus: {{interface: invid-virtual, channel: separating, bitrate_bit_per_s: 1000000, cycle_s: 0.001}}
axes:
  - name: A1
    node_id: 1
    rated_torque_Nm: 50
    masses: 2
    inertia_kgm2: 3
    gravity_loaded: false
    limits: {{torque_Nm: 25, position_window_rad: 0.5, velocity_rad_per_s: 3, stopping_room_rad: 3}}
safety: {{heartbeat_s: 0.03}}  # how it stops leaves it the amplitude that telling them apart takes
simulation:
  seed: 1
  plant: {{branches: [{{axis: A1, masses: [1.0, 2.0], springs: [1500], dampers: [0.8]}}]}}
  defaults: {{encoder_counts_per_rev: 524288, torque_noise_fraction_of_rated: 0.005}}
  effects:
    - {{cause: torque_delay, axis: A1, parameters: {{delay: {LATE}}}}}
experiments:  # below 6 Hz a lag of 4 ms takes a hundredth off the amplitude, at most
  - {{kind: multisine, role: identify, band_Hz: [0.5, 6], period_s: 2, periods: 2, experiments: 1, seed: 1}}
  - {{kind: multisine, role: validate, band_Hz: [0.5, 6], period_s: 2, periods: 2, experiments: 1, seed: 2}}
"""


def test_a_delay_not_told_from_a_lag_is_told_after_the_experiment_the_diagnosis_asks_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, first, second = tmp_path / "cell.yaml", tmp_path / "first.h5", tmp_path / "second.h5"
    before, after = tmp_path / "before.json", tmp_path / "after.json"
    config.write_text(CELL, encoding="utf-8")

    assert run(["measure", str(config), "-o", str(first)]) == 0
    assert run(["diagnose", str(first), "-o", str(before)]) == 0
    (open_,) = json.loads(before.read_text(encoding="utf-8"))["findings"]
    rivals = {open_["cause"], *(a["cause"] for a in open_["alternatives"])}
    assert rivals == {"torque_delay", "torque_lag"}
    assert open_["separating_experiment"] is not None
    capsys.readouterr()

    assert run(["measure", str(config), "--separate", str(before), "-o", str(second)]) == 0
    assert "a lag loses amplitude and a delay does not" in capsys.readouterr().err
    bands = [
        max(float(np.max(e.frequencies_hz)) for e in read_recording(p).experiments) for p in (first, second)
    ]
    assert bands[1] > 2 * bands[0]

    assert run(["diagnose", str(first), "--with", str(second), "-o", str(after), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads(after.read_text(encoding="utf-8"))
    (told,) = document["findings"]
    assert document["verdict"] == "explained"
    assert told["cause"] == "torque_delay"
    assert told["alternatives"] == []
    assert told["separating_experiment"] is None
    delay = told["parameters"]["delay"]
    # A sample that the torque is held over is convention, half of it either way.
    assert delay["value"] == pytest.approx(LATE, abs=0.001)
    assert delay["std"] < 0.0005

    # Nothing is left to separate, and that is said before anything moves.
    assert run(["measure", str(config), "--separate", str(after), "-o", str(tmp_path / "third.h5")]) == 2
    assert "nothing to separate" in capsys.readouterr().err
    assert not (tmp_path / "third.h5").exists()
