"""One master a bus."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
import yaml

from invid.config import parse_config
from invid.errors import BusError
from invid_drivers.cia402.reservation import Reservation
from invid_drivers.connect import connect

CONFIG = Path(__file__).parents[3] / "configs" / "case-study-unix.yaml"
HOLD = (
    "import sys; from invid_drivers.cia402.reservation import Reservation; "
    "r = Reservation(sys.argv[1], sys.argv[2]); print('held', flush=True); sys.stdin.read()"
)


def holder(channel: str, **environment: str) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, "socketcan", channel],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, **environment},
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def test_a_second_process_is_told_who_uses_the_bus_until_the_first_has_died(tmp_path: Path) -> None:
    """Whatever folders either of them has: a second user has others."""
    channel = f"can-{os.getpid()}"
    first = holder(channel, XDG_STATE_HOME=str(tmp_path), HOME=str(tmp_path), TMPDIR=str(tmp_path))
    try:
        with pytest.raises(BusError, match=rf"another invid process.*process {first.pid} of "):
            Reservation("socketcan", channel, patience_s=0.1)
        Reservation("socketcan", channel + "-other", patience_s=0.0).release()
    finally:
        first.kill()
        first.communicate()
    again = Reservation("socketcan", channel, patience_s=0.0)  # the kernel let go of it
    again.release()
    again.release()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_another_user_is_refused_the_bus_as_well() -> None:
    channel = f"can-user-{os.getpid()}"
    held = Reservation("socketcan", channel)
    code = (
        "import os, sys; from invid_drivers.cia402.reservation import Reservation; os.setuid(65534)\n"
        "try: Reservation('socketcan', sys.argv[1], patience_s=0.0)\n"
        "except Exception as error: print(type(error).__name__, error)"
    )
    try:
        said = subprocess.run(
            [sys.executable, "-c", code, channel], capture_output=True, text=True, check=True
        )
        assert said.stdout.startswith("BusError")
        assert f"process {os.getpid()} of root" in said.stdout
    finally:
        held.release()


def test_where_the_kernel_has_no_names_a_locked_file_keeps_others_away(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    held = Reservation("socketcan", "can0", named=False)
    with pytest.raises(BusError, match="another invid process"):
        Reservation("socketcan", "can0", patience_s=0.0, named=False)
    held.release()
    Reservation("socketcan", "can0", patience_s=0.0, named=False).release()


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
