"""Friction that changes sign over a range of velocity, as every simulator but an exact one has it."""

import sys
from pathlib import Path

import numpy as np
import pytest

from invid.diagnosis.diagnose import diagnose
from invid.model.document import model_from_json, model_to_json
from invid.recording import read_recording

sys.path.insert(0, str(Path(__file__).parents[2] / "system"))
import foreign_cell

TORQUE, ROUNDING = 2.0, 0.02
"""[N·m] and [rad/s]: the motor of this plant moves at a few hundredths rad/s rms."""


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    plant = foreign_cell.plant([[2.5, 0.8]], [[1500.0]], {})
    plant.coulomb, plant.rounding = [TORQUE], ROUNDING
    experiments = foreign_cell.measure(
        plant, np.random.default_rng(5), peak=[12.0], period=4096, periods=2, band=(0.5, 12.0), hold_gain=80.0
    )
    for e in experiments:
        e["attributes"]["hold_gain"] = np.array([np.nan])
    target = tmp_path_factory.mktemp("rounded") / "rec.h5"
    foreign_cell.write_recording(target, experiments, ["A1"])
    return target


@pytest.mark.campaign
def test_dry_friction_with_a_gradual_change_of_sign_is_dry_friction(path: Path) -> None:
    recording = read_recording(path)
    found = diagnose(recording, masses=[2])
    (finding,) = found.findings
    assert finding.effect.cause == "coulomb_friction"
    assert finding.effect.value("torque") == pytest.approx(TORQUE, rel=0.05)
    assert finding.effect.value("rounding") == pytest.approx(ROUNDING, rel=0.3)
    # The extended model is a model like any other: saved, loaded, given back, nothing is left to find.
    again = diagnose(recording, model=model_from_json(model_to_json(found.model)))
    assert not again.findings
    assert again.residual[0].after < 2.0 * again.residual[0].noise_floor
