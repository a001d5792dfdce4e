"""What a right simulator misses, whatever a diagnosis made of the record's sampling; play and noise."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines.mujoco_cells import Cell, drawn, measured, users, write

import invid
from invid.model.document import Estimate, Model
from invid.simulators.guided import Guided, Sampling, Simulator, guided, missed
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
