"""Cells whose physics is MuJoCo's: what the product says of a few."""

from pathlib import Path
from typing import Any

import pytest

import invid
from invid.model.diagnosis_document import Diagnosis
from machines.mujoco_cells import drawn, measured, write

pytestmark = pytest.mark.campaign
FRICTION = {"coulomb_friction", "stribeck_friction", "presliding_friction", "asymmetric_friction"}


def said(folder: Path, **draw: Any) -> Diagnosis:
    cell = drawn(motion="multisine", **draw)
    write(cell, measured(cell), folder / "rec.h5")
    return invid.diagnose(invid.read_recording(folder / "rec.h5"), budget=60)


def test_a_linear_chain_that_mujoco_simulates_is_consistent(tmp_path: Path) -> None:
    diagnosis = said(tmp_path, seed=3, kinds=(), sizes=(2, 2))
    assert (diagnosis.verdict, diagnosis.findings) == ("consistent", ())


# Each stands at least 15 dB over the noise; ``None``: the cause has no other place on that axis.
@pytest.mark.parametrize(
    ("kind", "seed", "sizes", "causes", "place"),
    [
        ("base", 21, (2, 2), {"base_compliance"}, None),
        ("cogging", 4, (1,), {"cogging"}, None),
        ("hard dry", 4, (1,), FRICTION, "mass 1"),
        ("plastic", 4, (2,), {"spring_hysteresis"}, "spring 1"),
        ("delay", 4, (2,), {"torque_delay", "torque_lag"}, None),
        ("cubic", 4, (2,), {"cubic_stiffness"}, "spring 1"),
        ("mode", 4, (2, 3), {"extra_mode"}, "mass 2"),
    ],
)
def test_what_stands_20_db_out_in_mujoco_is_named_at_its_place(
    kind: str, seed: int, sizes: tuple[int, ...], causes: set[str], place: str | None, tmp_path: Path
) -> None:
    size = 0.3 if kind == "base" else 0.5
    diagnosis = said(tmp_path, seed=seed, kinds=(kind,), sizes=sizes, size=size)
    right, sure_and_wrong = [], []
    for f in diagnosis.findings:
        named = [(f.cause, f.element), *((a.cause, a.element) for a in f.alternatives)]
        if any(c in causes and place in (None, e) for c, e in named):
            right.append(f)
        elif f.confidence >= 0.9:
            sure_and_wrong.append(f)
    assert right
    assert not sure_and_wrong


def test_a_load_s_mode_is_no_base_whose_stiffness_nothing_tells(tmp_path: Path) -> None:
    """It was one at 0.999, of 143 kN·m/rad, give or take 362."""
    cell = drawn(640010)
    write(cell, measured(cell), tmp_path / "rec.h5")
    named = {(f.cause, f.axis) for f in invid.diagnose(invid.read_recording(tmp_path / "rec.h5")).findings}
    assert ("extra_mode", "R1") in named
    assert "base_compliance" not in {cause for cause, _ in named}
