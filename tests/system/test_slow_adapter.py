"""Real drives behind an adapter that takes four milliseconds: refused before one of them is enabled."""

import collections
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import can
import pytest
import yaml

from invid.config import CellConfig, load_config
from invid.errors import ConfigError
from invid_drivers import connect
from invid_drivers.cli.check import preflight
from invid_drivers.connect import connect as connect_cell
from invid_drivers.measurement import run_measurement
from invid_drivers.simulated.unix_bus import UnixBus
from invid_drivers.stopping_budgets import Wish

ROOT = Path(__file__).parents[2]
INVID = [sys.executable, "-c", "from invid.cli import main; main()"]
pytestmark = pytest.mark.xdist_group("realtime")


class LateBus(UnixBus):
    """Frames come as late as an adapter that hands them over in lots makes them."""

    late_s = 0.004

    def __init__(self, channel: Any, **options: Any) -> None:
        super().__init__(channel, **options)
        self._coming: collections.deque[tuple[float, can.Message]] = collections.deque()

    def recv(self, timeout: float | None = None) -> can.Message | None:
        end = time.monotonic() + (timeout or 0.0)
        while True:
            while (message := super().recv(0)) is not None:
                self._coming.append((time.monotonic() + self.late_s, message))
            if self._coming and self._coming[0][0] <= time.monotonic():
                return self._coming.popleft()[1]
            if time.monotonic() >= end:
                return None
            time.sleep(0.0001)


@pytest.fixture
def cell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CellConfig:
    """A config without a simulation, of drives that a process of their own simulates."""
    data = yaml.safe_load((ROOT / "configs" / "case-study-unix.yaml").read_text(encoding="utf-8"))
    data["bus"] |= {"channel": str(tmp_path / "bus.sock"), "cycle_s": 0.001}
    (tmp_path / "cell.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    del data["simulation"]
    (tmp_path / "hardware.yaml").write_text(yaml.safe_dump(data), encoding="utf-8")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(connect, "open_adapter", lambda bus: LateBus(bus.channel))
    return load_config(tmp_path / "hardware.yaml")


def test_check_says_so_and_no_measurement_enables_a_drive(cell: CellConfig, tmp_path: Path) -> None:
    simcell = subprocess.Popen(
        [*INVID, "simcell", str(tmp_path / "cell.yaml"), "--duration", "100", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=dict(os.environ),
    )
    assert simcell.stderr is not None
    try:
        assert "ready" in simcell.stderr.readline()
        said = preflight(cell)[0].said
        assert any("the adapter or the drives' own time for SDO" in w for w in said), said
        with pytest.raises(ConfigError, match=r"[Ss]et bus\.cycle_s to 0\.0"):
            run_measurement(cell, Wish(), connect_cell(cell), tmp_path / "run.h5")
        assert not (tmp_path / "run.h5").exists()
    finally:
        simcell.send_signal(signal.SIGINT)
        out, said = simcell.communicate(timeout=60)
    for drive in json.loads(out)["drives"]:
        assert drive["state"] == "switch_on_disabled", said
