"""A real ``invid serve`` in its own process, on a small simulated cell, over loopback."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

# One axis with two masses, 8 s of robot time: a whole run takes a few seconds.
SMALL_CELL = """\
format: invid-config
format_version: 1
robot: small cell
bus: {interface: invid-virtual, channel: small, cycle_s: 0.001}
axes:
  - name: A1
    node_id: 1
    rated_torque_Nm: 50
    masses: 2
    inertia_kgm2: 3.0
    gravity_loaded: false
    limits: {torque_Nm: 25, position_window_rad: 1.0, velocity_rad_per_s: 5, stopping_room_rad: 3}
safety: {heartbeat_s: 0.03}  # the drive stops 0.09 s after its master has died
experiments:
  - {kind: multisine, band_Hz: [0.5, 12], period_s: 2.048, periods: 3}
  - {kind: multisine, role: validate, band_Hz: [0.5, 12], period_s: 2.048, periods: 2, amplitude: 0.5}
simulation:
  plant:
    branches: [{axis: A1, masses_kgm2: [1.0, 2.0], springs_Nm_per_rad: [1500], dampers_Nms_per_rad: [1.0]}]
  defaults: {torque_noise_fraction_of_rated: 0.002}
"""
STIFF_CELL = SMALL_CELL + "  axes: {A1: {friction: {coulomb_Nm: 1.0}}}\n"
ENDED = {"succeeded", "failed", "cancelled", "stopped", "interrupted"}


class Serving:
    """The process and a client of it."""

    def __init__(self, process: subprocess.Popen[str], url: str, folder: Path) -> None:
        self.process, self.url, self.folder = process, url, folder
        self.client = httpx.Client(base_url=url, timeout=20.0, trust_env=False)

    def start(self, cell: str | None = None, **body: Any) -> str:
        """Start a run, of the first cell where none is named; its address."""
        cell = cell or self.client.get("/api/v1/cells").json()["cells"][0]["id"]
        given = {"mode": "full", "arm": True, **body}
        answer = self.client.post(f"/api/v1/cells/{cell}/identifications", json=given)
        assert answer.status_code == 202, answer.text
        return str(answer.headers["Location"])

    def wait(self, location: str, *states: str, timeout: float = 90.0) -> dict[str, Any]:
        """Poll until one of ``states``; any other end fails."""
        deadline = time.monotonic() + timeout
        body: dict[str, Any] = {}
        while time.monotonic() < deadline:
            body = self.client.get(location).json()
            if body["state"] in states:
                return body
            assert body["state"] not in ENDED, body
            time.sleep(0.05)
        raise AssertionError(f"no {states} within {timeout} s: {body}")

    def wait_for_motion(self, location: str, timeout: float = 180.0, share: float = 0.1) -> None:
        """Until the first recorded experiment is under way (trials at low amplitude come before it).

        ``share`` of the run's time into it: its first period settles and is not recorded. Starting the
        process of a run takes two seconds, on a machine that has eight other things to do forty.
        """
        deadline = time.monotonic() + timeout
        body: dict[str, Any] = {}
        began: float | None = None
        while time.monotonic() < deadline:
            body = self.client.get(location).json()
            assert body["state"] not in ENDED, body
            if body["state"] == "running" and body["phase"].startswith("experiment"):
                began = body["progress"] if began is None else began
                if body["progress"] > began + share:
                    return
            time.sleep(0.02)
        raise AssertionError(f"no motion within {timeout} s: {body}")

    def run_to_result(self, **body: Any) -> str:
        """A whole run, up to the decision."""
        location = self.start(**body)
        self.wait(location, "awaiting_accept")
        return location

    def runners(self) -> list[int]:
        """Runner processes of this service that are alive (their job's folder is ours)."""
        found = []
        for entry in Path("/proc").iterdir():
            if not entry.name.isdigit():
                continue
            try:
                command = (entry / "cmdline").read_bytes()
                log = os.readlink(entry / "fd" / "2") if b"invid_service.jobs.worker" in command else ""
            except OSError:
                continue
            if log.startswith(str(self.folder.resolve())):
                found.append(int(entry.name))
        return found

    def kill(self) -> None:
        """kill -9."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(10)


@contextmanager
def serving(
    folder: Path, *arguments: str, cell: str | None = SMALL_CELL, env: dict[str, str] | None = None
) -> Iterator[Serving]:
    """``invid serve`` on a free port with its data in ``folder``."""
    configs = []
    if cell is not None:
        config = folder / "small.yaml"
        config.write_text(cell)
        configs = [str(config)]
    command = [
        sys.executable,
        "-c",
        "from invid.cli import main; main()",
        "serve",
        *configs,
        "--port",
        "0",
        "--data-dir",
        str(folder / "data"),
    ]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "INVID_MIN_FREE_BYTES": "1000000", **(env or {})}
    process = subprocess.Popen(
        [*command, *arguments], stderr=subprocess.PIPE, text=True, cwd=folder, env=environment
    )
    assert process.stderr is not None
    lines: list[str] = []
    url = None
    for line in process.stderr:
        lines.append(line)
        if match := re.search(r"invid serve: (http://\S+?)/ ", line):
            url = match.group(1)
            break
    assert url is not None, "".join(lines)
    drain = threading.Thread(target=lambda: lines.extend(process.stderr or []), daemon=True)
    drain.start()
    found = Serving(process, url, folder)
    try:
        deadline = time.monotonic() + 30
        while True:
            try:
                if found.client.get("/health/live").status_code == 200:
                    break
            except httpx.TransportError:
                assert time.monotonic() < deadline, "".join(lines)
                assert process.poll() is None, "".join(lines)
                time.sleep(0.05)
        yield found
    finally:
        found.client.close()
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
