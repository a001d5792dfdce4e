"""What a right simulator misses, whatever a diagnosis made of the record's sampling; play and noise."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from machines.mujoco_cells import Cell, drawn, measured, users, write

import invid
from invid.model.document import Model
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


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("kind", "motion"), [("lag", "multisine"), ("delay", "chirp"), ("play", "multisine")]
)
def test_the_xml_that_made_a_recording_misses_what_noise_leaves(
    kind: str, motion: str, tmp_path: Path
) -> None:
    simulator, model, record = given(drawn(5, kinds=(kind,), motion=motion, sizes=(2,)), tmp_path)
    assert floors(missed(simulator, [record], model), record, model) < 1.2
