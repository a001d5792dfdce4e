"""What an integrator installs: units that systemd takes, a compose file that fits the Dockerfile."""

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

from invid_service.service import _ORPHAN_S
from invid_service.settings import Settings

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


def test_what_the_drives_were_told_is_remembered_where_the_container_lasts() -> None:
    dockerfile = (DEPLOY.parent / "Dockerfile").read_text(encoding="utf-8")
    state = re.search(r"XDG_STATE_HOME=(\S+)", dockerfile).group(1)  # type: ignore[union-attr]
    service = yaml.safe_load((DEPLOY / "compose.yaml").read_text(encoding="utf-8"))["services"]["invid"]
    assert service["read_only"]
    assert state in [v.split(":")[1] for v in service["volumes"] if not v.endswith(":ro")]


def test_whoever_ends_the_service_does_not_end_its_runner() -> None:
    unit = (DEPLOY / "systemd" / "invid.service").read_text(encoding="utf-8")
    assert re.search(r"^KillMode=process$", unit, flags=re.MULTILINE)
    assert re.search(r"^OOMPolicy=continue$", unit, flags=re.MULTILINE)
    patience = re.search(r"^TimeoutStartSec=(\d+)$", unit, flags=re.MULTILINE).group(1)  # type: ignore[union-attr]
    assert int(patience) > Settings().stop_grace_s + _ORPHAN_S
    dockerfile = (DEPLOY.parent / "Dockerfile").read_text(encoding="utf-8")
    assert 'ENTRYPOINT ["python", "-m", "invid_service.supervision", "invid"]' in dockerfile


def test_process_one_outlives_a_service_until_its_runner_has_ended(tmp_path: Path) -> None:
    held = tmp_path / "held"
    runner = f"import time, pathlib; time.sleep(2); pathlib.Path({str(held)!r}).touch()"
    serve = (
        "import os, signal, subprocess, sys\n"
        f"subprocess.Popen([sys.executable, '-c', {runner!r}], start_new_session=True)\n"
        "print('ready', flush=True)\n"
        "signal.pause()"
    )
    one = subprocess.Popen(
        [sys.executable, "-m", "invid_service.supervision", sys.executable, "-c", serve],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert one.stdout is not None
    assert one.stdout.readline() == "ready\n"
    one.terminate()  # which goes to the service, and that dies of it
    assert one.wait(timeout=30) == 128 + signal.SIGTERM
    assert held.exists()
    one.stdout.close()


def listening(folder: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listener.bind(str(folder / "notify"))
    listener.settimeout(60)
    return listener


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
