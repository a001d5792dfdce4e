"""``invid diagnose --plots``: pictures and their data agree with what was hidden."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from hidden.generator import make

from invid.cli.app import run
from invid.recording import write_recording


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> tuple[Path, dict, float]:
    """The folder, the document on stdout, the friction hidden."""
    folder = tmp_path_factory.mktemp("plots")
    recording, truth = make("coulomb_friction", seed=11, motors=1, target_db=25)
    path = folder / "rec.h5"
    write_recording(recording, path)
    out = folder / "pictures"
    status = run(
        [
            "diagnose",
            str(path),
            "-o",
            str(folder / "d.json"),
            "--report",
            str(folder / "r.html"),
            "--plots",
            str(out),
        ]
    )
    assert status == 0
    document = json.loads((folder / "d.json").read_text())
    return out, document, truth.effects[0].parameters["torque"]


def columns(path: Path) -> dict[str, np.ndarray]:
    with path.open() as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(r[name]) for r in rows]) for name in rows[0]}


@pytest.mark.campaign
def test_every_picture_is_whole_svg_with_its_data_beside_it(written) -> None:
    out, document, _ = written
    axis = document["residual"][0]["axis"]
    names = {p.name for p in out.iterdir()}
    assert {f"missing-{axis}.svg", f"missing-{axis}.csv", f"replay-{axis}.svg", "index.json"} <= names
    for path in out.glob("*.svg"):
        root = ElementTree.fromstring(path.read_text())
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert "mathdefault" not in path.read_text()


@pytest.mark.campaign
def test_the_missing_torque_over_velocity_is_the_friction_that_was_hidden(written) -> None:
    out, document, torque = written
    waves = columns(out / f"missing-{document['residual'][0]['axis']}.csv")
    fast = np.abs(waves["velocity"]) > 0.5 * waves["velocity"].std()
    sign = np.sign(waves["velocity"][fast])
    assert np.mean(sign * waves["missing_torque"][fast]) == pytest.approx(torque, rel=0.15)
    assert {"time", "position", "acceleration", "deflection_1"} <= set(waves)
