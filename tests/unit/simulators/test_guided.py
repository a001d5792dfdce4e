"""What a right simulator misses, whatever a diagnosis made of the record's sampling; play and noise."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines.mujoco_cells import Cell, drawn, measured, users, write

import invid
from invid.model.document import Estimate, Model
from invid.simulators.guided import Guided, Sampling, Simulator, guided, missed, moved_by_noise
from invid.simulators.open import open_simulator


def given(cell: Cell, folder: Path) -> tuple[Simulator, Model, Guided]:
    """The XML that made the recording, what it claims, and the record for validation."""
    write(cell, measured(cell), folder / "rec.h5")
    (folder / "robot.xml").write_text(users(cell))
    recording = invid.read_recording(folder / "rec.h5")
    simulator = open_simulator(folder / "robot.xml", recording.axes)
    model = simulator.claimed()
    assert model is not None
    record = recording.experiments[-1]
    return simulator, model, guided(record, Sampling.of(model), recording.encoder_resolution)


def floors(found: Any, given: Guided, model: Model) -> float:
    """Largest of the axes."""
    power = (np.abs(found.spectra[0]) ** 2).sum(axis=0) / given.floor(model).sum(axis=0)
    return float(np.sqrt(power.max()))


@pytest.mark.parametrize(
    ("kind", "motion"), [("lag", "multisine"), ("delay", "chirp"), ("play", "multisine")]
)
def test_the_xml_that_made_a_recording_misses_what_noise_leaves(
    kind: str, motion: str, tmp_path: Path
) -> None:
    simulator, model, record = given(drawn(5, kinds=(kind,), motion=motion, sizes=(2,)), tmp_path)
    assert floors(missed(simulator, [record], model), record, model) < 1.2


def test_a_wrong_offset_of_the_torque_samples_is_not_held_against_a_simulator(tmp_path: Path) -> None:
    cell = drawn(5, kinds=("hard dry",), motion="multisine", sizes=(1,))
    simulator, model, record = given(cell, tmp_path)
    right = missed(simulator, [record], model)
    shifted = record.read(Sampling(np.array([0.9e-3]), np.array([0.0])))
    found = missed(simulator, [shifted], model)
    assert floors(found, record, model) == pytest.approx(floors(right, record, model), rel=0.1)
    assert found.records[0].sampling.later == pytest.approx(right.records[0].sampling.later, abs=5e-5)
    # More than a sample is a delay, and the simulator's.
    late = replace(record, torque=np.roll(record.torque, 4, axis=0))
    assert floors(missed(simulator, [late], model), record, model) > 5.0


@pytest.mark.parametrize("seed", [5, 6])
def test_play_by_a_second_joint_is_read_and_set(seed: int, tmp_path: Path) -> None:
    made = drawn(seed, kinds=("play",), motion="multisine", sizes=(2,))
    play = replace(made.hidden[0], numbers={"gap": 1e-3, "joint": 1.0})
    (tmp_path / "robot.xml").write_text(users(replace(made, hidden=(play,))))
    simulator = open_simulator(tmp_path / "robot.xml", made.axes)
    model = simulator.claimed()
    assert model is not None
    (term,) = model.effects
    assert (term.cause, term.element) == ("backlash", "spring 1")
    assert term.value("gap") == pytest.approx(1e-3)
    assert model.chains.masses[0] == pytest.approx(made.inertia[0], rel=2e-3)
    less = replace(term, parameters={"gap": replace(term.parameters["gap"], value=4e-4)})
    for effects, gap in (((less,), 4e-4), ((), 0.0)):
        copy, lost = simulator.corrected(replace(model, effects=effects), tmp_path / "copy.xml")
        claimed = copy.claimed()
        assert claimed is not None
        assert sum(t.value("gap") for t in claimed.effects) == pytest.approx(gap, abs=1e-8)
        assert not lost


def test_a_mass_on_a_link_that_carries_another_axis_is_an_effect_and_no_mass_of_the_chain(
    tmp_path: Path,
) -> None:
    cell = drawn(907, kinds=(), motion="multisine", sizes=(2, 1))
    cell = replace(cell, carried=(False, True), tilt=0.7)
    xml = users(cell).replace(
        '<body name="q2_1">',
        '<body name="m"><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
        '<joint name="m" axis="0 0 1" stiffness="90" damping="0.02"/></body><body name="q2_1">',
    )
    (tmp_path / "robot.xml").write_text(xml)
    simulator = open_simulator(tmp_path / "robot.xml", cell.axes)
    model = simulator.claimed()
    assert model is not None
    assert model.chains.masses_per_branch == (2, 1)
    (term,) = model.effects
    assert (term.cause, term.axis, term.element) == ("extra_mode", "R1", "mass 2")
    assert (term.value("mass"), term.value("stiffness")) == pytest.approx((0.01, 90.0))
    heavier = replace(term, parameters={**term.parameters, "mass": Estimate(0.02, None, "kg·m²")})
    copy, _ = simulator.corrected(replace(model, effects=(heavier,)), tmp_path / "copy.xml")
    again = copy.claimed()
    assert again is not None
    (found,) = again.effects
    assert (found.value("mass"), found.value("stiffness")) == pytest.approx((0.02, 90.0), rel=1e-3)
    assert again.chains.masses[0] == pytest.approx(model.chains.masses[0], rel=1e-3)


def test_noise_moves_a_simulator_with_play_in_production_more_than_a_linear_plant(tmp_path: Path) -> None:
    ratios = []
    for kinds in ((), ("play",)):
        cell = drawn(5, kinds=kinds, motion="production", sizes=(2,), size=0.8)
        simulator, model, record = given(cell, tmp_path)
        moved = moved_by_noise(simulator, missed(simulator, [record], model), model)[0]
        ratios.append(float(np.sqrt(moved.sum() / record.floor(model).sum())))
    assert 0.7 < ratios[0] < 1.3
    assert ratios[1] > 5.0
