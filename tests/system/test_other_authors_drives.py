"""Drives of another author in another process (`durand_process`), judged on their own plant."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from invid.recording import read_recording

HERE = Path(__file__).parent
INVID = [sys.executable, "-c", "from invid.cli import main; main()"]
pytestmark = [pytest.mark.campaign, pytest.mark.xdist_group("realtime")]
LIMIT, WINDOW, COMMISSIONED = 8.0, 0.5, 0.6
FOREIGN = 9
HELD = 0.02
"""How far a loaded axis may be from where it stopped until the user acts [rad]."""


class OtherCell:
    """The process, and what truly happened in it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        spec = {
            "socket": str(folder / "bus.sock"),
            "nodes": [
                # commissioned tighter than the config: 6 N·m of the rated 10
                {"node_id": 1, "masses": [0.5], "values": {"0x6072": 600}},
                {"node_id": 2, "masses": [0.4, 0.3], "spring": 800.0, "gravity": 1.5, "enable": 0.15},
            ],
            "foreign": [FOREIGN],
        }
        (folder / "other.json").write_text(json.dumps(spec), encoding="utf-8")
        self._process = subprocess.Popen(
            [sys.executable, str(HERE / "durand_process.py"), str(folder / "other.json")],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"

    def truth(self, *, mark: bool = False) -> dict[str, Any]:
        """Extremes since the last mark."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write("mark\n" if mark else "tell\n")
        self._process.stdin.flush()
        document: dict[str, Any] = json.loads(self._process.stdout.readline())
        return document

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()

    def invid(self, *arguments: str) -> subprocess.Popen[str]:
        """A command of the product."""
        environment = {**os.environ, "XDG_STATE_HOME": str(self.folder / "state")}
        return subprocess.Popen(
            [*INVID, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env=environment, cwd=self.folder,
        )  # fmt: skip


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[OtherCell]:
    other = OtherCell(tmp_path)
    write_config(tmp_path)
    yield other
    other.close()


def write_config(folder: Path, **second: Any) -> None:
    limits = {
        "torque_Nm": LIMIT, "position_window_rad": WINDOW, "velocity_rad_per_s": 3,
        "stopping_room_rad": 1000,  # in the three seconds that a drive waits for its master
    }  # fmt: skip
    data = {
        "format": "invid-config",
        "robot": "another author's",
        "bus": {"interface": "invid-unix", "channel": str(folder / "bus.sock"), "cycle_s": 0.004},
        "axes": [
            {"name": "A1", "node_id": 1, "inertia_kgm2": 0.5, "limits": limits},
            {
                "name": "A2", "node_id": 2, "inertia_kgm2": 0.7, "limits": limits, "gravity_loaded": True,
                **second,
            },
        ],
        # the machine that runs the tests is busy with other tests
        "safety": {"missed_tpdos": 100, "overrun_cycles": 100, "heartbeat_s": 1.0},
        "experiments": [
            {"kind": "multisine", "band_Hz": [2, 12], "period_s": 1.024, "periods": 2, "settle_periods": 0,
             "experiments": 1}
        ],
    }  # fmt: skip
    (folder / "cell.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")


def test_a_healthy_run_keeps_the_tightest_limits_and_leaves_a_foreign_node_alone(cell: OtherCell) -> None:
    scan = cell.invid(
        "init", "--interface", "invid-unix", "--channel", str(cell.folder / "bus.sock"), "-o", "first.yaml"
    )
    _, said = scan.communicate(timeout=240)
    assert scan.returncode == 0, said
    assert cell.truth()["foreign"] == {str(FOREIGN): []}
    check = cell.invid("check", "cell.yaml", "--json")
    out, said = check.communicate(timeout=240)
    assert check.returncode == 0, said + out
    assert cell.truth()["foreign"] == {str(FOREIGN): []}
    run = cell.invid("measure", "cell.yaml", "-o", "run.h5")
    _, said = run.communicate(timeout=240)
    assert run.returncode == 0, said
    truth = cell.truth()
    assert truth["foreign"] == {str(FOREIGN): []}
    first, second = truth["drives"]
    assert 0 < first["commanded"] <= 1.05 * COMMISSIONED * 10
    assert first["by_loop"] <= 1.05 * COMMISSIONED * 10
    assert first["max_torque"] == 600
    assert 0 < second["commanded"] <= 1.05 * LIMIT
    assert max(first["travel"], second["travel"]) <= WINDOW
    assert read_recording(cell.folder / "run.h5").experiments


@pytest.mark.panel
def test_a_loaded_axis_stays_where_it_stopped_until_the_user_acts(cell: OtherCell) -> None:
    run = cell.invid("measure", "cell.yaml", "-o", "run.h5")
    assert run.stderr is not None
    for line in run.stderr:
        if "experiment" in line:
            break
    time.sleep(0.5)
    run.send_signal(signal.SIGINT)
    _, said = run.communicate(timeout=240)
    assert run.returncode == 4, said
    cell.truth(mark=True)
    time.sleep(3.5)  # longer than the heartbeat watch
    assert cell.truth()["drives"][1]["travel"] <= HELD
    check = cell.invid("check", "cell.yaml")
    out, said = check.communicate(timeout=240)
    assert check.returncode == 5, said + out
    assert "NOT READY" in out
    assert cell.truth()["drives"][1]["state"] == "quick stop active"
    again = cell.invid("measure", "cell.yaml", "-o", "again.h5")
    assert again.stderr is not None
    for line in again.stderr:
        if "trying" in line:
            break
    again.send_signal(signal.SIGINT)
    again.communicate(timeout=240)
    time.sleep(0.5)
    truth = cell.truth()
    assert truth["drives"][1]["travel"] <= HELD, truth
    assert truth["foreign"] == {str(FOREIGN): []}
