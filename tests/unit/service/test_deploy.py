"""What an integrator installs: units that systemd takes, a compose file that fits the Dockerfile."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from invid_service.settings import Settings
from invid_service.supervision import tell, watchdog_s

ROOT = Path(__file__).parents[3]
DEPLOY = ROOT / "deploy"
UNITS = {"invid.service": "invid.service", "invid-can@.service": "invid-can@can0.service"}


def units_with(folder: Path) -> list[str]:
    """The units with commands that are there on this machine."""
    made = []
    for name, instance in UNITS.items():
        text = (DEPLOY / "systemd" / name).read_text(encoding="utf-8")
        text = re.sub(r"/opt/invid/bin/invid|/sbin/ip\b", "/bin/true", text)
        text = re.sub(r"^Documentation=.*\n", "", text, flags=re.MULTILINE)
        for target in {name, instance}:
            (folder / target).write_text(text)
        made.append(str(folder / instance))
    return made


def analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    if shutil.which("systemd-analyze") is None:
        reason = "systemd-analyze is not installed: the systemd units are NOT checked"
        print(reason)
        pytest.skip(reason)
    return subprocess.run(
        ["systemd-analyze", *arguments], capture_output=True, text=True, timeout=60, check=False
    )


def test_systemd_takes_the_units_without_a_word(tmp_path: Path) -> None:
    done = analyze("verify", *units_with(tmp_path))
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


def test_the_units_are_hardened(tmp_path: Path) -> None:
    for unit in units_with(tmp_path):
        done = analyze("security", "--offline=yes", "--threshold=25", unit)
        assert done.returncode == 0, done.stdout[-300:]


def test_the_cycles_priority_and_memory_need_no_capability() -> None:
    text = (DEPLOY / "systemd" / "invid.service").read_text(encoding="utf-8")
    limits = dict(re.findall(r"^Limit(\w+)=(.+)$", text, flags=re.MULTILINE))
    assert "\nCapabilityBoundingSet=\n" in text
    if os.geteuid() != 0 or shutil.which("setpriv") is None:
        pytest.skip("needs root and setpriv: that SCHED_FIFO needs no capability is NOT checked")
    program = (
        "import os, ctypes; from pathlib import Path; assert 'CapEff:\\t0000000000000000' in "
        "Path('/proc/self/status').read_text(); os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(50)); "
        "assert ctypes.CDLL(None).mlockall(3) == 0"
    )
    command = ["prlimit", f"--rtprio={limits['RTPRIO']}", "--memlock=unlimited", "setpriv", "--reuid=65534"]
    command += ["--regid=65534", "--clear-groups", "--bounding-set=-all", "--inh-caps=-all", "--no-new-privs"]
    system_python = shutil.which("python3", path="/usr/bin:/usr/local/bin") or sys.executable
    command += [system_python, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "prlimit: failed" in done.stderr:
        pytest.skip(f"{done.stderr.strip()}: that SCHED_FIFO needs no capability is NOT checked")
    assert done.returncode == 0, done.stderr


def served(arguments: list[str]) -> None:
    """Whether ``invid serve`` takes these arguments; it fails only on the config, which is not there."""
    import typer

    from invid_service.cli import register

    app = typer.Typer()
    register(app)
    result = CliRunner().invoke(app, ["--help"])
    assert result.exit_code == 0
    for option in (a.partition("=")[0] for a in arguments if a.startswith("--")):
        assert option in CliRunner().invoke(app, ["--help"], env={"COLUMNS": "200"}).output, option


def test_the_commands_are_ones_that_serve_takes() -> None:
    text = (DEPLOY / "systemd" / "invid.service").read_text(encoding="utf-8")
    command = shlex.split(re.search(r"^ExecStart=(.+)$", text, flags=re.MULTILINE).group(1))  # type: ignore[union-attr]
    assert command[1] == "serve"
    served(command[2:])
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text(encoding="utf-8"))
    assert compose["services"]["invid"]["command"][0] == "serve"
    served(compose["services"]["invid"]["command"][1:])


def test_the_compose_file_fits_the_dockerfile() -> None:
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text(encoding="utf-8"))
    service, database = compose["services"]["invid"], compose["services"]["postgres"]
    assert (DEPLOY / service["build"] / "Dockerfile").resolve() == ROOT / "Dockerfile"
    dockerfile = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert 'ENTRYPOINT ["invid"]' in dockerfile
    assert "VOLUME /data" in dockerfile
    assert "data:/data" in service["volumes"]
    assert service["cap_drop"] == ["ALL"]
    assert "privileged" not in service
    # Nobody but this machine reaches the database or the service.
    assert all(p.startswith("127.0.0.1:") for p in database["ports"])
    assert "--host=127.0.0.1" in service["command"]
    assert "[postgres" in dockerfile
    grace = int(service["stop_grace_period"].removesuffix("s"))
    unit = (DEPLOY / "systemd" / "invid.service").read_text(encoding="utf-8")
    # Whoever stops the service leaves the runner time to stop its drives, and the service to tell it.
    needed = Settings().stop_grace_s + 10.0
    assert grace > needed
    assert int(re.search(r"^TimeoutStopSec=(\d+)$", unit, flags=re.MULTILINE).group(1)) > needed  # type: ignore[union-attr]


def listening(folder: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener.bind(str(folder / "notify"))
    listener.settimeout(60)
    return listener


def test_systemd_is_told_where_it_listens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    assert tell("READY=1") is False
    with listening(tmp_path) as listener:
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        assert tell("READY=1") is True
        assert listener.recv(100) == b"READY=1"
    monkeypatch.setenv("WATCHDOG_USEC", "30000000")
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    assert watchdog_s() == pytest.approx(10.0)
    monkeypatch.setenv("WATCHDOG_PID", "1")
    assert watchdog_s() is None
    monkeypatch.setenv("WATCHDOG_USEC", "soon")
    assert watchdog_s() is None


@pytest.mark.service
def test_a_service_says_ready_alive_and_stopping(tmp_path: Path) -> None:
    with listening(tmp_path) as listener:
        given = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "600000"}
        process = subprocess.Popen(
            [sys.executable, "-m", "invid", "serve", "--port", "0", "--data-dir", str(tmp_path / "data")],
            env={**os.environ, **given},
            stderr=subprocess.PIPE,
        )
        try:
            assert listener.recv(100) == b"READY=1"
            began = time.monotonic()
            assert [listener.recv(100) for _ in range(3)] == [b"WATCHDOG=1"] * 3
            assert time.monotonic() - began < 10
            process.terminate()
            while (said := listener.recv(100)) == b"WATCHDOG=1":
                pass
            assert said == b"STOPPING=1"
            assert process.wait(timeout=60) in (0, -signal.SIGTERM)  # systemd takes both for a clean end
        finally:
            process.kill()
            process.communicate()
