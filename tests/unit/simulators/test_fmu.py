"""An FMU as a user's simulator: wrong numbers told, and its parameters set right."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from machines.mujoco_cells import drawn, measured, users, write
from pythonfmu.builder import FmuBuilder

import invid
from invid.simulators.guided import Sampling, guided, missed
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


FMI_2 = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

class Motor(Fmi2Slave):
    author = "another tool"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.torque, self.inertia, self.position, self.speed = 0.0, INERTIA, 0.0, 0.0
        self.register_variable(Real("torque", causality=Fmi2Causality.input))
        self.register_variable(Real("position", causality=Fmi2Causality.output))
        self.register_variable(Real("R1.mass.1", causality=Fmi2Causality.parameter,
            variability=Fmi2Variability.tunable, getter=lambda: self.inertia,
            setter=lambda value: setattr(self, "inertia", value)))

    def do_step(self, current_time, step_size):
        gained = self.torque / self.inertia * step_size
        self.position += (self.speed + 0.5 * gained) * step_size
        self.speed += gained
        return True
"""


def test_an_fmu_of_fmi_2_is_run_and_set_right_like_one_of_fmi_3(tmp_path: Path) -> None:
    cell = drawn(4, kinds=(), motion="multisine", sizes=(1,))
    write(cell, measured(cell), tmp_path / "rec.h5")
    recording = invid.read_recording(tmp_path / "rec.h5")
    diagnosis = invid.diagnose(recording)
    (tmp_path / "motor.py").write_text(FMI_2.replace("INERTIA", str(1.3 * cell.inertia[0][0])))
    made = FmuBuilder.build_FMU(tmp_path / "motor.py", dest=tmp_path)
    simulator = open_simulator(Path(made), recording.axes)
    found = judge(recording, diagnosis, simulator, tmp_path / "set.json")
    assert found["engine"].startswith("FMI 2")
    assert [p["name"] for p in found["parameters"]] == ["R1 mass 1"]
    assert found["parameters"][0]["simulator"] == pytest.approx(1.3 * cell.inertia[0][0])
    assert found["held_out"]["after"] < 1.2 < 10.0 < found["held_out"]["before"]


def test_a_right_fmu_that_begins_at_rest_reaches_the_floor_of_a_record_that_begins_in_motion(
    tmp_path: Path,
) -> None:
    cell = drawn(12, kinds=(), motion="multisine", sizes=(2,))
    write(cell, measured(cell), tmp_path / "rec.h5")
    recording = invid.read_recording(tmp_path / "rec.h5")
    (tmp_path / "robot.xml").write_text(users(cell))
    model = open_simulator(tmp_path / "robot.xml", recording.axes).claimed()
    assert model is not None
    invid.export(model, "fmu", tmp_path / "robot.fmu")
    simulator = open_simulator(tmp_path / "robot.fmu", recording.axes)
    held = guided(recording.experiments[-1], Sampling.of(model), recording.encoder_resolution)
    found = missed(simulator, [held], model)
    assert np.linalg.norm(found.spectra[0]) < 1.2 * np.sqrt(held.floor(model).sum())
    assert held.lead == 0
