"""Asking moves and sends nothing: no GET writes to a bus; what must ask the drives is a POST of its own."""

import threading
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import can
import pytest
from fastapi.testclient import TestClient
from service_doubles import CELL, Director, running, wait_for

from invid_drivers.cia402.journal import journal_path
from invid_drivers.cia402.standing.hold_memory import HoldMemory, Seen
from invid_drivers.simulated.unix_bus import UnixHub

CELLS = "/api/v1/cells"


class Wire:
    """A bus on which nobody answers; what is sent on it is kept."""

    memory: HoldMemory

    def __init__(self, path: Path) -> None:
        self.path, self.frames = path, list[can.Message]()
        self._over = threading.Event()
        self._hub = UnixHub(str(path))
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self) -> None:
        while not self._over.is_set():
            message = self._hub.recv(0.02)
            if message is not None:
                self.frames.append(message)

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        self._hub.shutdown()


@pytest.fixture
def wire(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Wire]:
    """A cell with hardware behind it, of which an earlier run left A2 energised."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    made = Wire(tmp_path / "wire.sock")
    virtual = "{interface: invid-virtual, channel: test, cycle_s: 0.001}"
    bus = f"{{interface: invid-unix, channel: {made.path}, cycle_s: 0.001}}"
    (tmp_path / "cell.yaml").write_text(CELL.split("simulation:")[0].replace(virtual, bus))
    memory = HoldMemory.beside(journal_path("invid-unix", str(made.path)))
    memory.keep("a drive", Seen(2, loaded=True, holds=True, resumes=False, left_held=True))
    made.memory = memory
    yield made
    made.close()


def gets(client: TestClient) -> list[str]:
    """Every GET that needs no parameter but a cell, and the polls of page and PLC among them."""
    paths = client.get("/api/v1/openapi.json").json()["paths"]
    found = [p.replace("{cell}", "cell") for p, methods in paths.items() if "get" in methods]
    return [p for p in found if "{" not in p and "events" not in p]


def test_no_get_sends_a_frame_and_what_is_remembered_says_as_of_when(wire: Wire, tmp_path: Path) -> None:
    with running(tmp_path) as (client, _):
        asked = gets(client)
        assert {f"{CELLS}/cell/readiness", f"{CELLS}/cell/state", "/api/v1/state", CELLS} <= set(asked)
        for _ in range(2):
            for path in asked:
                client.get(path)
        ready = client.get(f"{CELLS}/cell/readiness").json()
        (reason,) = ready["reasons"]
        assert reason["code"] == "axis_energised"
        assert abs((datetime.now(UTC) - datetime.fromisoformat(reason["seen"])).total_seconds()) < 60
    assert wire.frames == []


def test_a_check_asks_the_drives_and_says_what_they_said(wire: Wire, tmp_path: Path) -> None:
    with running(tmp_path) as (client, _):
        found = client.post(f"{CELLS}/cell/check").json()
        assert {m.arbitration_id for m in wire.frames} >= {0x601}
        assert not found["can_start"]
        codes = [r["code"] for r in found["reasons"]]
        assert sorted(codes) == [
            "axis_energised",
            "check_refused",
        ]  # nobody answers: what is remembered stands
        assert found["simulated"] is False
        log = (tmp_path / "data" / "audit.jsonl").read_text(encoding="utf-8")
        assert '"check"' in log


def test_a_runner_that_dies_in_motion_leaves_what_is_known_of_each_axis(wire: Wire, tmp_path: Path) -> None:
    wire.memory.keep("a drive", Seen(2, loaded=True, holds=True, resumes=True, left_held=True))
    wire.memory.keep("another", Seen(1, in_run=True))
    with running(tmp_path, Director(held_in="running")) as (client, director):
        location = client.post(f"{CELLS}/cell/identifications", json={"mode": "full", "arm": True}).headers[
            "Location"
        ]
        wait_for(client, location, "running")
        client.portal.call(director.workers[0].killed.set)  # type: ignore[union-attr]
        failed = wait_for(client, location, "failed")
        assert failed["error"]["code"] == "runner-died"
        assert "axis A1 (node 1) may be energised" in failed["error"]["text"]
        assert "axis A2 (node 2) is energised" in failed["error"]["text"]
        assert "make sure that every axis stands" in failed["error"]["fix"]
    assert wire.frames == []
