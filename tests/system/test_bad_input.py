"""Bad input: one message, the right exit status, no traceback, and files already there left alone."""

import io
import json
import os
import shutil
import subprocess
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml
from test_contract_surface import write_recording

from invid.cli.app import run
from invid.config import load_config
from invid.errors import ConfigError
from invid_drivers.measurement import measure_to_file

CONFIG = Path(__file__).parents[2] / "configs" / "case-study.yaml"


def invid(*arguments: str) -> subprocess.CompletedProcess[str]:
    """The command in this process: a start of its own would cost more than all of it."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = run([*arguments])
    return subprocess.CompletedProcess(arguments, status, out.getvalue(), err.getvalue())


def assert_one_message(done: subprocess.CompletedProcess[str], status: int, *words: str) -> None:
    assert done.returncode == status, done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    assert "internal error" not in done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("invid: ")]
    assert len(lines) == 1, done.stderr
    for word in words:
        assert word in lines[0], lines[0]


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bad") / "good.h5"
    write_recording(path, np.arange(1, 100, 2), 5.0, 0.01)
    return path


def edit(action: Callable[[h5py.File], None]) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        with h5py.File(path, "r+") as f:
            action(f)

    return apply


def empty(path: Path) -> None:
    path.write_bytes(b"")


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def text(path: Path) -> None:
    path.write_text("time,pos\n0,1\n")


def nan_position(f: h5py.File) -> None:
    f["experiments/000/position"][123, 0] = np.nan


def time_backwards(f: h5py.File) -> None:
    f["experiments/000/time"][200] = 0.0


def no_position(f: h5py.File) -> None:
    del f["experiments/000/position"]


def no_experiments(f: h5py.File) -> None:
    del f["experiments"]


BAD_RECORDINGS: dict[str, tuple[Callable[[Path], None], tuple[str, ...]]] = {
    "empty file": (empty, ("bad.h5",)),
    "truncated HDF5": (truncated, ("bad.h5",)),
    "not HDF5": (text, ("bad.h5",)),
    "NaN": (edit(nan_position), ("bad.h5", "000", "position", "123")),
    "time running backwards": (edit(time_backwards), ("bad.h5", "000", "time")),
    "no position": (edit(no_position), ("bad.h5", "000", "position")),
    "no experiments": (edit(no_experiments), ("bad.h5", "experiments")),
}


@pytest.mark.parametrize("name", BAD_RECORDINGS)
def test_a_bad_recording_is_refused_in_one_message(name: str, good: Path, tmp_path: Path) -> None:
    damage, words = BAD_RECORDINGS[name]
    bad = tmp_path / "bad.h5"
    shutil.copy(good, bad)
    damage(bad)
    kept = tmp_path / "model.json"
    kept.write_text("kept")
    assert_one_message(invid("identify", str(bad), "--masses", "2", "-o", str(kept)), 2, *words)
    assert kept.read_text() == "kept"


def test_a_recording_that_is_not_there_is_said_so(tmp_path: Path) -> None:
    for command in ("identify", "diagnose"):
        assert_one_message(invid(command, str(tmp_path / "none.h5")), 2, "none.h5")


@pytest.mark.parametrize("masses", ["2,2,2", "two", "-1,2"])
def test_a_wrong_number_of_masses_is_refused(masses: str, good: Path) -> None:
    done = invid("identify", str(good), "--masses", masses, "--json")
    assert done.returncode == 2, done.stderr
    assert json.loads(done.stdout)["refused"]["code"]
    assert "Traceback" not in done.stderr


def changed_config(tmp_path: Path, change: Callable[[dict], None]) -> Path:
    document = yaml.safe_load(CONFIG.read_text())
    change(document)
    path = tmp_path / "cell.yaml"
    path.write_text(yaml.safe_dump(document, allow_unicode=True))
    return path


def unknown_key(document: dict) -> None:
    document["axes"][0]["torgue_limit"] = 3


def negative_limit(document: dict) -> None:
    limits = document["axes"][1]["limits"]
    limits[next(iter(limits))] = -1.0


def twice_the_node(document: dict) -> None:
    document["axes"][1]["node_id"] = document["axes"][0]["node_id"]


def pull_the_cable(document: dict) -> None:
    document["simulation"]["faults"] = [{"kind": "node_silent", "at_s": 0.0, "axis": "A3"}]


def only_positions(document: dict) -> None:
    document["simulation"].setdefault("axes", {})["A2"] = {"objects": {"lacks": ["0x6071"]}}


@pytest.mark.parametrize(
    ("change", "status", "words"),
    [
        (unknown_key, 2, ("cell.yaml", "torgue_limit")),
        (negative_limit, 2, ("cell.yaml", "-1")),
        (twice_the_node, 2, ("cell.yaml", "node")),
        (pull_the_cable, 5, ("A3",)),
        (only_positions, 5, ("A2", "torque")),
    ],
)
def test_a_bad_config_and_a_drive_that_cannot_are_refused_before_an_earlier_recording_is_touched(
    change: Callable[[dict], None], status: int, words: tuple[str, ...], tmp_path: Path
) -> None:
    path = changed_config(tmp_path, change)
    kept = tmp_path / "rec.h5"
    kept.write_text("kept")
    assert_one_message(invid("measure", str(path), "-o", str(kept)), status, *words)
    assert_one_message(invid("check", str(path)), status, *words)
    assert kept.read_text() == "kept"


@pytest.mark.parametrize("out", ["pipe", "/proc/none/rec.h5", "file/rec.h5"])
def test_a_recording_that_could_not_be_kept_is_refused_before_anything_moves(
    out: str, tmp_path: Path
) -> None:
    # A robot that was shaken for nothing, or a device replaced by a file, is worse than a message.
    (tmp_path / "file").write_text("no folder")
    os.mkfifo(tmp_path / "pipe")
    moved: list[object] = []
    config = load_config(changed_config(tmp_path, lambda _: None))
    with pytest.raises(ConfigError, match="name a file for the recording"):
        measure_to_file(config, tmp_path / out, progress=moved.append)
    assert moved == []
    assert (tmp_path / "pipe").is_fifo()
