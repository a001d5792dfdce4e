"""A stranger's package of one file each: another kind of file, another format for models."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, Model

READER = '''
"""Records of the GRID logger: its four letters, the number of rows, rows of time, position and torque."""
import numpy as np
from invid.recording.readers.kinds import FileKind
from invid.recording.tables import Table


def read(path, source, *, beside=None):
    rows = np.frombuffer(path.read_bytes()[8:], np.float64).reshape(3, -1)
    return Table(str(path), dict(zip(("time", "position", "torque"), rows)))


GRID = FileKind("grid", "grid_files:read", starts=(b"GRID",), endings=(".grid",))
'''
EXPORT = '''
"""The frequencies of a model's modes, one a line."""
import numpy as np


def losses(plant):
    return ["damping"]


def content(plant, spread, *, robot, losses):
    square = np.linalg.eigvals(np.linalg.solve(plant.mass, plant.stiffness)).real
    return "\\n".join(f"{np.sqrt(max(w, 0.0)) / (2 * np.pi):.6f}" for w in sorted(square)).encode()
'''


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    (tmp_path / "grid_files.py").write_text(READER)
    (tmp_path / "mode_list.py").write_text(EXPORT)
    about = tmp_path / "stranger-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[invid.readers]\ngrid = grid_files:GRID\n\n[invid.exports]\nmodes = mode_list\n"
    )
    return tmp_path


def invid(installed: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "invid", *words],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(installed), *filter(None, sys.path)])},
        cwd=installed,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("kind", ["", "  kind: grid\n"])
def test_a_kind_of_file_of_an_installed_package_is_read_by_its_bytes_and_by_its_name(
    installed: Path, kind: str
) -> None:
    time = np.arange(4000) * 1e-3
    rows = np.array([time, np.sin(40 * time), np.cos(40 * time)])
    (installed / "run.grid").write_bytes(b"GRID" + b"\0" * 4 + rows.tobytes())
    (installed / "map.yaml").write_text(
        "format: invid-import-map\nformat_version: 1\nrobot: bench\n"
        + (f"source:\n{kind}" if kind else "")
        + "time: {column: time, unit: s}\naxes:\n- name: A1\n  position: {column: position, unit: rad}\n"
        "  torque: {column: torque, unit: N·m}\nexperiments:\n- {rows: [0, null]}\n"
    )
    found = invid(installed, "import", "run.grid", "-o", "rec.h5", "--map", "map.yaml")
    assert found.returncode == 0, found.stderr
    assert (installed / "rec.h5").exists()


def test_a_format_of_an_installed_package_is_written_and_an_unknown_one_is_told_the_names(
    installed: Path,
) -> None:
    chains = CoupledChains.build([[1.0, 2.0]], [[100.0]], [[0.1]], np.zeros((1, 1)), axes=("A1",))
    Model("bench", "refined", chains, ChainStd.unknown(chains)).save(installed / "model.json")
    assert invid(installed, "export", "model.json", "--to", "modes", "-o", "modes.txt").returncode == 0
    hz = np.loadtxt(installed / "modes.txt")
    assert hz == pytest.approx([0.0, np.sqrt(100.0 * 1.5) / (2 * np.pi)], abs=1e-3)
    assert json.loads((installed / "modes.txt.json").read_text())["losses"] == ["damping"]
    refused = invid(installed, "export", "model.json", "--to", "nothing", "-o", "x")
    assert refused.returncode == 2
    assert "statespace, mjcf, urdf, fmu, modes" in refused.stderr


def test_a_kind_that_nobody_reads_is_told_the_names(installed: Path) -> None:
    (installed / "run.csv").write_text("time,position,torque\n0,0,0\n1,1,1\n2,0,1\n")
    (installed / "map.yaml").write_text(
        "format: invid-import-map\nformat_version: 1\nrobot: bench\nsource: {kind: gird}\n"
        "time: {column: time, unit: s}\naxes:\n- name: A1\n  position: {column: position, unit: rad}\n"
        "  torque: {column: torque, unit: N·m}\nexperiments:\n- {rows: [0, null]}\n"
    )
    refused = invid(installed, "import", "run.csv", "-o", "rec.h5", "--map", "map.yaml")
    assert refused.returncode == 2
    assert "'gird'" in refused.stderr
    assert "csv" in refused.stderr
    assert "grid" in refused.stderr


@pytest.mark.parametrize("broken", ["grid_files.py", "mode_list.py"])
def test_a_package_that_cannot_be_loaded_is_named_in_one_sentence(installed: Path, broken: str) -> None:
    (installed / broken).write_text("import what_is_not_there\n")
    (installed / "run.csv").write_text("time,position,torque\n0,0,0\n1,1,1\n2,0,1\n")
    chains = CoupledChains.build([[1.0, 2.0]], [[100.0]], [[0.1]], np.zeros((1, 1)), axes=("A1",))
    Model("bench", "refined", chains, ChainStd.unknown(chains)).save(installed / "model.json")
    asked = {
        "grid_files.py": ("import", "--suggest", "run.csv"),
        "mode_list.py": ("export", "model.json", "--to", "modes", "-o", "x"),
    }
    refused = invid(installed, *asked[broken])
    assert refused.returncode == 2
    assert "package stranger, entry point" in refused.stderr
    assert "what_is_not_there" in refused.stderr
    assert "Traceback" not in refused.stderr
