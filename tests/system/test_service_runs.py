"""Whole runs of a real ``invid serve`` with its real runner on a small simulated cell."""

import contextlib
import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import h5py
import httpx
import pytest
from service_process import SMALL_CELL, Serving, serving

from invid.cli.app import run
from invid.model.diagnosis_document import Verdict
from invid.model.document import model_from_json
from invid.recording import read_recording

# As many as all others together; every one needs a process with numba in it.
pytestmark = pytest.mark.service


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Serving]:
    """One that lives on when a run of it is stopped or dies, or its clients misbehave."""
    with serving(tmp_path_factory.mktemp("service")) as served:
        yield served


def test_a_run_measures_identifies_diagnoses_and_is_accepted(tmp_path: Path) -> None:
    # A torque limit of six times the rated torque is worth a question.
    asking = SMALL_CELL.replace("rated_torque_Nm: 50", "rated_torque_Nm: 4")
    with serving(tmp_path, cell=asking) as service:
        location = service.start(arm=False)
        plan = service.wait(location, "awaiting_arm")["plan"]
        (budget,) = plan["budgets"]  # how far the axis goes after a stop, and when this computer dies
        assert 0 < budget["stopping_distance"] <= budget["dead_master_distance"] <= budget["room"] * 1.001
        assert plan["forecast"][0]["axis"] == "A1"
        assert 0 < plan["forecast"][0]["peak_torque"] <= 25
        assert plan["duration_s"] > 5
        service.client.post(f"{location}/actions", json={"type": "arm"})
        seen = service.wait(location, "running")
        assert seen["simulated"] is True
        answers, moves = (
            os.getpriority(os.PRIO_PROCESS, p) for p in (service.process.pid, *service.runners())
        )
        assert answers <= moves
        assert moves >= 0, "the runner kept the precedence of the service"
        body = service.wait(location, "awaiting_accept")
        assert body["summary"]["verdict"] in set(Verdict)
        seen = body["measurement"]
        assert seen["outcome"] == "completed"
        assert seen["skipped_slots"] == 0
        assert 0 < seen["peaks"]["A1"]["travel"] < 1.0
        # What the measurement had to say is said to whoever decides on the result.
        assert set(seen["warnings"]) <= set(body["summary"]["warnings"])
        assert any("is that limit meant?" in w for w in seen["warnings"])
        with service.client.stream("GET", f"{location}/events") as stream:
            kinds = []
            for line in stream.iter_lines():
                if line.startswith("event: "):
                    kinds.append(line[7:])
                if '"state":"awaiting_accept"' in line:
                    break
        assert kinds.count("progress") >= 3
        model = model_from_json(service.client.get(f"{location}/model").json())
        # The truth stands in the cell's config above the test, not in the service.
        assert model.chains.masses[0].tolist() == pytest.approx([1.0, 2.0], rel=0.05)
        assert model.chains.springs[0].tolist() == pytest.approx([1500.0], rel=0.05)
        diagnosis = service.client.get(f"{location}/diagnosis").json()
        assert diagnosis["format"] == "invid-diagnosis"
        assert diagnosis["simulated"] is True
        report = service.client.get(f"{location}/report")
        assert report.headers["content-type"].startswith("text/html")
        assert report.text.count("no hardware") == 1
        assert f"run {body['id']} · started by local" in report.text
        assert model.provenance["recording"] == f"{body['id']}/recording.h5"
        assert str(tmp_path) not in report.text + str(diagnosis)
        assert "http://" not in report.text.replace("http://www.w3.org", "")
        file = tmp_path / "fetched.h5"
        file.write_bytes(service.client.get(f"{location}/recording").content)
        assert str(read_recording(file).outcome) == "completed"
        done = service.client.post(f"{location}/actions", json={"type": "accept"}).json()
        assert done["state"] == "succeeded"
        assert service.client.get("/api/v1/cells/small/model").json()["id"] == done["id"]
        # The same recording from elsewhere, with no drive involved.
        answer = service.client.post(
            "/api/v1/recordings", content=file.read_bytes(), headers={"Content-Type": "application/x-hdf5"}
        )
        uploaded = service.wait(answer.headers["Location"], "succeeded")
        assert uploaded["mode"] == "upload"
        assert uploaded["simulated"] is True  # the recording says so itself
        again = model_from_json(service.client.get(f"{answer.headers['Location']}/model").json())
        assert again.chains.masses[0].tolist() == pytest.approx(model.chains.masses[0].tolist(), rel=1e-6)


def test_a_stop_in_mid_motion_stops_the_drives_and_keeps_the_recording(
    service: Serving, tmp_path: Path
) -> None:
    location = service.start()
    service.wait_for_motion(location)
    began = time.monotonic()
    answer = service.client.post("/api/v1/cells/small/stop")
    assert time.monotonic() - began < 2.0  # queued behind the run it would take tens of seconds
    assert answer.json()["stopping"] is True
    service.wait(location, "stopped", timeout=10)
    file = tmp_path / "stopped.h5"
    file.write_bytes(service.client.get(f"{location}/recording").content)
    with h5py.File(file) as recording:
        assert recording.attrs["outcome"] == "aborted"
    deadline = time.monotonic() + 10
    while service.runners() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert service.runners() == []


@pytest.mark.parametrize("state", ["running", pytest.param("awaiting_arm", marks=pytest.mark.campaign)])
def test_a_service_killed_in_mid_run_takes_its_motion_with_it_and_starts_again_clean(
    tmp_path: Path, state: str
) -> None:
    with serving(tmp_path) as service:
        location = service.start(arm=state == "running")
        if state == "running":
            service.wait_for_motion(location)
        else:
            service.wait(location, state)
        service.kill()
    with serving(tmp_path) as service:
        body = service.client.get(location).json()
        assert body["state"] == "interrupted"
        assert body["error"]["fix"]
        assert service.runners() == []
        if state == "running":
            file = tmp_path / "cut.h5"
            file.write_bytes(service.client.get(f"{location}/recording").content)
            with h5py.File(file) as recording:  # the runner itself stopped its drives and closed it
                assert recording.attrs["outcome"] == "aborted"
        fresh = service.start(arm=False)
        service.wait(fresh, "awaiting_arm")
        service.client.post(f"{fresh}/actions", json={"type": "cancel"})
        assert service.client.get(location).json()["state"] == "interrupted"


def test_a_killed_runner_makes_its_run_fail_and_the_next_one_starts(service: Serving) -> None:
    location = service.start()
    service.wait(location, "running")
    (runner,) = service.runners()
    os.kill(runner, signal.SIGKILL)
    body = service.wait(location, "failed")
    assert body["error"]["code"] == "runner-died"
    fresh = service.start(arm=False)
    service.wait(fresh, "awaiting_arm")
    service.client.post(f"{fresh}/actions", json={"type": "cancel"})


def test_a_signal_stops_the_motion_before_the_service_ends(tmp_path: Path) -> None:
    with serving(tmp_path) as service:
        location = service.start()
        service.wait(location, "running")
        follower = httpx.Client(base_url=service.url, trust_env=False)
        with follower.stream("GET", f"{location}/events", timeout=30) as stream:
            service.process.terminate()
            list(stream.iter_lines())  # ends with the service, does not hold it up
        assert service.process.wait(15) in (0, -signal.SIGTERM)
        assert service.runners() == []
    with serving(tmp_path) as service:
        assert service.client.get(location).json()["state"] == "interrupted"


def test_clients_that_hang_and_headers_without_end_take_no_room_and_no_stop(service: Serving) -> None:
    def memory(process: int) -> int:
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
        return pages * resource.getpagesize()

    with contextlib.ExitStack() as stack:
        host, port = service.url.removeprefix("http://").split(":")

        def connect() -> socket.socket:
            return stack.enter_context(socket.create_connection((host, int(port)), timeout=20))

        hanging = [connect() for _ in range(300)]
        for n, line in enumerate(hanging):
            line.sendall(b"GET /health/live HTTP/1.1\r\nX-Slow: "[: n % 30])
        assert service.client.post("/api/v1/cells/small/stop").status_code == 200
        before = memory(service.process.pid)
        endless = connect()
        with contextlib.suppress(OSError):  # the service may close before all of it is sent
            endless.sendall(b"GET / HTTP/1.1\r\nHost: x\r\nX-Endless: " + b"a" * 20_000_000)
        assert memory(service.process.pid) - before < 10_000_000
        noise = connect()
        noise.sendall(b"\x16\x03\x01 this is no HTTP\r\n\r\n")
        said = b"".join(iter(lambda: noise.recv(4096), b""))
        assert said.startswith(b"HTTP/1.1 400")
        assert b"application/problem+json" in said
        assert b"urn:invid:problem:bad-request" in said
        assert service.client.get("/health/ready").status_code == 200


def test_a_key_made_on_the_command_line_opens_a_service_on_every_address(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["keys", "add", "plc:read,run", "--key-file", "keys.json"]) == 0
    token = capsys.readouterr().out.strip()
    assert token not in (tmp_path / "keys.json").read_text()
    with serving(tmp_path, "--host", "0.0.0.0", "--key-file", "keys.json") as service:
        assert service.client.get("/api/v1/cells").status_code == 401
        answer = service.client.get("/api/v1/cells", headers={"Authorization": f"Bearer {token}"})
        assert answer.status_code == 200


def test_the_service_refuses_a_port_beyond_loopback_without_a_key_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "small.yaml").write_text(SMALL_CELL)
    # In a process of its own: the service sets where its process logs.
    command = [sys.executable, "-m", "invid", "serve", "small.yaml", "--host", "0.0.0.0", "--port", "0"]
    refused = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert refused.returncode == 2
    assert "no key" in refused.stderr
    assert "Traceback" not in refused.stderr


FILES = 256
HALVES = (
    b"",
    b"GET /api/v1/state HTTP/1.1\r\nHost: 127",
    b"POST /api/v1/recordings HTTP/1.1\r\nHost: 127.0.0.1\r\n",
)


@pytest.mark.campaign
def test_three_hundred_silent_connections_and_fifty_pollers_keep_no_stop_waiting(tmp_path: Path) -> None:
    with serving(tmp_path) as service, contextlib.ExitStack() as all_of_them:
        resource.prlimit(service.process.pid, resource.RLIMIT_NOFILE, (FILES, FILES))
        address = ("127.0.0.1", int(service.url.rsplit(":", 1)[1]))
        for k in range(300):
            silent = all_of_them.enter_context(socket.create_connection(address))
            silent.sendall(HALVES[k % len(HALVES)])
        over, answers = threading.Event(), list[int]()

        def poll() -> None:
            with httpx.Client(base_url=service.url, trust_env=False, timeout=20) as client:
                while not over.is_set():
                    with contextlib.suppress(httpx.HTTPError):
                        answers.append(client.get("/api/v1/state").status_code)
                    over.wait(0.5)

        pollers = [threading.Thread(target=poll) for _ in range(50)]
        for poller in pollers:
            poller.start()
        try:
            took = []
            for _ in range(5):
                began = time.monotonic()
                with httpx.Client(base_url=service.url, trust_env=False, timeout=20) as client:
                    assert client.post("/api/v1/stop").status_code == 200
                took.append(time.monotonic() - began)
                time.sleep(0.3)
        finally:
            over.set()
            for poller in pollers:
                poller.join()
        assert sorted(took)[2] < 1.0, took
        assert answers.count(200) > 50
