"""An FMU as a user's simulator: wrong numbers told, and its parameters set right."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from machines.mujoco_cells import drawn, measured, write
from pythonfmu.builder import FmuBuilder

import invid
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, EffectTerm, Estimate, Model
from invid.recording import Experiment, Kind, Recording, Role
from invid.simulators import fmu_engine
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


DRIVE = """
import os
from pythonfmu import DefaultExperiment, Fmi2Causality, Fmi2Slave, Real

class NAME(Fmi2Slave):
    author = "another tool"

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.default_experiment = DefaultExperiment(step_size=0.001)
        self.tau = self.q = self.v = self.p = self.w = 0.0
        self.register_variable(Real("tau", causality=Fmi2Causality.input))
        self.register_variable(Real("q", causality=Fmi2Causality.output))

    def do_step(self, now, h):
        if now > LAST:
            os.kill(os.getpid(), 11)
        for _ in range(PARTS):
            spring = 800.0 * (self.q - self.p) + 0.4 * (self.v - self.w)
            self.v += h / PARTS * (self.tau - spring) / MOTOR
            self.w += h / PARTS * (spring - 0.9 * self.w) / 1.5
            self.q += h / PARTS * self.v
            self.p += h / PARTS * self.w
        return True
"""


def drive(folder: Path, name: str, *, parts: int = 20, motor: float = 0.5, last: float = 1e9) -> Path:
    """An FMU of fixed steps of 1 ms, each of so many of semi-implicit Euler; a crash after ``last`` [s]."""
    text = DRIVE.replace("NAME", name).replace("PARTS", str(parts)).replace("MOTOR", str(motor))
    (folder / f"{name}.py").write_text(text.replace("LAST", str(last)))
    fixed = {"canHandleVariableCommunicationStepSize": "false"}
    return Path(FmuBuilder.build_FMU(folder / f"{name}.py", dest=folder, **fixed))


@pytest.fixture(scope="module")
def bench() -> tuple[Any, Any]:
    """A drive's record of four periods, from its receptance, and the truth in place of a diagnosis."""
    rng, lines = np.random.default_rng(5), np.arange(3, 80, 4)
    t, wave = np.arange(8192) / 1000.0, 2 * np.pi * lines / 2.048
    phase = rng.uniform(0.0, 2 * np.pi, lines.size)
    torque = 2.0 * np.cos(np.outer(t, wave) + phase).sum(axis=1)
    s = 1j * wave
    link, load = 800.0 + 0.4 * s, 1.5 * s**2 + 0.9 * s
    motion = (link + load) / (0.5 * s**2 * (link + load) + link * load) * 2.0 * np.exp(1j * phase)
    position = (np.exp(1j * np.outer(t, wave)) @ motion).real
    noisy = (position + 2e-6 * rng.standard_normal(t.size), torque + 0.02 * rng.standard_normal(t.size))
    one = Experiment(
        key="000", kind=Kind.MULTISINE, role=Role.VALIDATE, excited_axis=0, hold_gain=np.zeros(1),
        period_samples=2048, frequencies_hz=lines / 2.048, sample_rate_hz=1000.0, time=t,
        position=noisy[0][:, None], torque=noisy[1][:, None],
    )  # fmt: skip
    chains = CoupledChains.build([[0.5, 1.5]], [[800.0]], [[0.4]], np.zeros((1, 1)), axes=("A1",))
    drag = EffectTerm("viscous_friction", "A1", {"coefficient": Estimate(0.9, 0.001, "N·m·s/rad")}, "mass 2")
    model = Model("bench", "refined", chains, ChainStd.unknown(chains), effects=(drag,))
    truth = SimpleNamespace(model=model, ruled_out=(), unexplained=None)
    return Recording("bench", ("A1",), "rad", "N·m", "", (one,)), truth


def test_a_right_fmu_of_one_fixed_step_reaches_the_floor(tmp_path: Path, bench: tuple[Any, Any]) -> None:
    recording, truth = bench
    found = judge(recording, truth, open_simulator(drive(tmp_path, "Fine"), ("A1",)))
    assert found["right"], found["sentences"]
    wrong = judge(recording, truth, open_simulator(drive(tmp_path, "Light", motor=0.45), ("A1",)))
    assert wrong["held_out"]["before"] > 10.0 * found["held_out"]["before"]
    assert "too coarse" not in " ".join(wrong["sentences"])


def test_a_fixed_step_that_is_too_coarse_is_said_in_place_of_a_cause(
    tmp_path: Path, bench: tuple[Any, Any]
) -> None:
    recording, truth = bench
    found = judge(recording, truth, open_simulator(drive(tmp_path, "Coarse", parts=1), ("A1",)))
    assert not found["right"]
    assert found["sentences"][1].startswith("Its step of 0.001 s is too coarse to judge it")
    assert not found["parameters"]
    assert not found["missing"]


def test_an_fmu_that_crashes_is_refused_and_takes_nothing_down(
    tmp_path: Path, bench: tuple[Any, Any]
) -> None:
    recording, truth = bench
    simulator = open_simulator(drive(tmp_path, "Crash", last=3.0), ("A1",))
    said = r"Crash\.fmu: the FMU's own code ended its process by SIGSEGV"
    with pytest.raises(invid.InputError, match=said):
        judge(recording, truth, simulator)


def test_an_fmu_that_hangs_is_refused(
    tmp_path: Path, bench: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    recording, truth = bench
    simulator = open_simulator(drive(tmp_path, "Slow"), ("A1",))
    monkeypatch.setattr(fmu_engine, "LONGEST_S", 0.5)
    with pytest.raises(
        invid.InputError, match=r"Slow\.fmu: the FMU has not simulated experiment 000 in 0\.5 s"
    ):
        judge(recording, truth, simulator)
