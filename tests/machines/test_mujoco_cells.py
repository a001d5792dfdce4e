"""Cells whose physics is MuJoCo's: what the product says of a few."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import invid
from invid.model.diagnosis_document import diagnosis_to_json
from machines import mujoco_cells
from machines.mujoco_cells import SIZES, drawn, measured, write
from machines.mujoco_score import scored, with_strengths

pytestmark = pytest.mark.campaign


def said(folder: Path, **draw: Any) -> dict[str, Any]:
    cell = drawn(**draw)
    runs = measured(cell)
    write(cell, runs, folder / "rec.h5")
    document = diagnosis_to_json(invid.diagnose(invid.read_recording(folder / "rec.h5"), budget=60))
    return scored(with_strengths(cell, runs), document)


def test_a_linear_chain_that_mujoco_simulates_is_consistent(tmp_path: Path) -> None:
    score = said(tmp_path, seed=3, kinds=(), motion="multisine", sizes=(2, 2))
    assert (score["verdict"], score["named"]) == ("consistent", [])


def test_a_base_that_mujoco_lets_give_way_is_named(tmp_path: Path) -> None:
    score = said(tmp_path, seed=21, kinds=("base",), motion="multisine", sizes=(2, 2), size=0.3)
    assert score["faults"][0][3] > 15.0
    assert score["faults"][0][4], score
    assert not score["sure_and_wrong"]


@pytest.mark.parametrize(
    ("kind", "sizes"),
    [("cogging", (1,)), ("hard dry", (1,)), ("plastic", (2,)), ("delay", (2,)), ("cubic", (2,))],
)
def test_what_stands_20_db_out_in_mujoco_is_named_at_its_place(
    kind: str, sizes: tuple[int, ...], tmp_path: Path
) -> None:
    score = said(tmp_path, seed=4, kinds=(kind,), motion="multisine", sizes=sizes, size=0.5)
    assert score["faults"][0][3] > 15.0
    assert score["faults"][0][4], score
    assert not score["sure_and_wrong"]


@pytest.mark.parametrize("kind", [k for k in SIZES if k != "base"])  # a heavier base moves less
def test_an_element_stands_out_more_the_larger_it_is_and_not_at_all_where_it_is_next_to_nothing(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mujoco_cells, "SUB", 4)  # decibels ask for no finer step
    found = []
    low, high = SIZES[kind]
    nothing = math.log(1e-3) / math.log(high / low)  # a thousandth of the least that is drawn
    for size in (nothing, 0.2, 0.9):
        cell = drawn(8, kinds=(kind,), motion="multisine", sizes=(2,), size=size)
        found.append(with_strengths(cell, measured(cell)).hidden[0].db)
    assert found[0] < min(found[1], 0.0)
    assert found[1] < found[2]
    assert np.isfinite(found).all()
