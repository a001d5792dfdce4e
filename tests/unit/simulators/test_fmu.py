"""An FMU as a user's simulator: wrong numbers told, and its parameters set right."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from machines.mujoco_cells import drawn, measured, write

import invid
from invid.simulators.judge import judge
from invid.simulators.open import open_simulator


@pytest.mark.campaign
def test_an_fmu_with_wrong_numbers_is_set_right_by_its_parameters(tmp_path: Path) -> None:
    cell = drawn(4, kinds=(), motion="multisine", sizes=(1,))
    write(cell, measured(cell), tmp_path / "rec.h5")
    recording = invid.read_recording(tmp_path / "rec.h5")
    diagnosis = invid.diagnose(recording)
    chains = diagnosis.model.chains
    wrong = replace(chains, masses=tuple(np.array(m) * 1.2 for m in chains.masses))
    invid.export(replace(diagnosis.model, chains=wrong), "fmu", tmp_path / "robot.fmu")
    found = judge(
        recording, diagnosis, open_simulator(tmp_path / "robot.fmu", recording.axes), tmp_path / "set.json"
    )
    assert found["engine"].startswith("FMI 3")
    assert [p["name"] for p in found["parameters"]] == ["R1 mass 1"]
    assert found["held_out"]["before"] > 10.0 * found["held_out"]["after"]
    assert found["held_out"]["after"] < 1.2
    start = json.loads((tmp_path / "set.json").read_text())["start_values"]
    assert abs(start["R1.mass.1"] / cell.inertia[0][0] - 1.0) < 0.01
