"""A recording that another program wrote, with only the required attributes, is identified alike."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import foreign_cell

# One worker makes the recording once for all tests of this file.
pytestmark = pytest.mark.xdist_group("foreign")

TRUTH = {
    "masses": [[0.7, 2, 3], [4, 5, 6], [7, 8, 9]],
    "springs": [[1000, 2000], [3000, 4000], [5000, 6000]],
    "couplings": {("A1", "A2"): 1.0, ("A1", "A3"): 2.0, ("A2", "A3"): 3.0},
}


def invid(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", "from invid.cli import main; main()", *arguments],
        capture_output=True,
        text=True,
        timeout=300,
    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("foreign") / "rec.h5"
    rng = np.random.default_rng(20261121)
    experiments = foreign_cell.measure(foreign_cell.case_study_plant(), rng, peak=[20.0, 40.0, 60.0])
    foreign_cell.write_recording(path, experiments, ["A1", "A2", "A3"])
    return path


def test_a_recording_with_only_the_required_attributes_gives_every_parameter(recording: Path) -> None:
    done = invid("identify", str(recording), "--masses", "3,3,3", "--json")
    assert done.returncode == 0, done.stderr
    model = json.loads(done.stdout)
    assert model["format"] == "invid-model"
    inside = total = 0
    for branch, masses, springs in zip(model["branches"], TRUTH["masses"], TRUTH["springs"], strict=True):
        for kind, truth in (("masses", masses), ("springs", springs)):
            for estimate, value in zip(branch[kind], truth, strict=True):
                assert estimate["value"] == pytest.approx(value, rel=0.02)
                inside += abs(estimate["value"] - value) <= 3 * estimate["std"]
                total += 1
    for coupling in model["couplings"]:
        value = TRUTH["couplings"][tuple(coupling["between"])]
        assert coupling["value"] == pytest.approx(value, rel=0.02)
        inside += abs(coupling["value"] - value) <= 3 * coupling["std"]
        total += 1
    assert total == 18
    assert inside >= 16


@pytest.mark.campaign
def test_the_number_of_masses_is_found_where_it_is_not_given(recording: Path) -> None:
    done = invid("identify", str(recording), "--masses", "auto", "--json")
    assert done.returncode == 0, done.stderr
    assert [len(b["masses"]) for b in json.loads(done.stdout)["branches"]] == [3, 3, 3]


@pytest.mark.campaign
def test_a_foreign_recording_of_a_linear_plant_is_consistent(recording: Path) -> None:
    done = invid("diagnose", str(recording), "--masses", "3,3,3", "--json")
    assert done.returncode == 0, done.stderr
    diagnosis = json.loads(done.stdout)
    assert diagnosis["verdict"] == "consistent"
    assert diagnosis["findings"] == []
