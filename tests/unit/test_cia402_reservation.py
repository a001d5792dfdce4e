"""One master a bus."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from invid.config import parse_config
from invid.errors import BusError
from invid_drivers.cia402.journal import Reservation
from invid_drivers.connect import connect

CONFIG = Path(__file__).parents[2] / "configs" / "case-study-unix.yaml"
HOLD = (
    "import sys, pathlib; from invid_drivers.cia402.journal import Reservation; "
    "r = Reservation(pathlib.Path(sys.argv[1])); print('held', flush=True); sys.stdin.read()"
)


def test_a_second_process_is_told_that_the_bus_is_in_use_until_the_first_has_died(tmp_path: Path) -> None:
    path = tmp_path / "state" / "bus.journal"
    first = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert first.stdout is not None
        assert first.stdout.readline() == "held\n"
        with pytest.raises(BusError, match="another invid process"):
            Reservation(path, patience_s=0.1)
    finally:
        first.kill()
        first.communicate()
    again = Reservation(path, patience_s=0.0)  # the kernel let go of it
    again.release()
    again.release()


def test_a_bus_that_cannot_be_opened_is_not_kept_reserved(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    data["bus"]["channel"] = str(tmp_path / "nobody.sock")
    config = parse_config(yaml.safe_dump(data))
    for _ in range(2):
        with pytest.raises(BusError, match="cannot be opened"):
            connect(config)
