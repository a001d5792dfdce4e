"""The state of every cell in one answer, and the stop of all: from memory, whatever store and drives do."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
from service_doubles import CELL, Director, running, start, wait_for

STATE, STOP = "/api/v1/state", "/api/v1/stop"


def of(client: Any, cell: str = "cell") -> dict[str, Any]:
    return next(c for c in client.get(STATE).json()["cells"] if c["cell"] == cell)


def known(client: Any) -> None:
    """Wait until the drives of every cell have said whether they may move."""
    end = time.monotonic() + 30.0
    while any(c["status"] == "unknown" for c in client.get(STATE).json()["cells"]):
        assert time.monotonic() < end
        time.sleep(0.05)


def two_cells(folder: Path) -> list[Path]:
    paths = [folder / "one.yaml", folder / "two.yaml"]
    for path in paths:
        text = CELL.replace("channel: test", f"channel: {path.stem}")
        path.write_text(text.replace("test robot", f"robot {path.stem}"))
    return paths


def test_a_cell_is_told_from_ready_through_motion_to_its_end_with_when(tmp_path: Path) -> None:
    director = Director(held_in="running")
    director.summary = {"grade": "watch"}
    with running(tmp_path, director) as (client, _):
        known(client)
        idle = of(client)
        assert (idle["status"], idle["run"], idle["moves"]) == ("ready", None, False)
        location = start(client)
        run = wait_for(client, location, "running")
        moving = of(client)
        assert (moving["state"], moving["run"], moving["moves"]) == ("running", run["id"], True)
        assert moving["since"] == run["started"]
        assert len(client.get(STATE).content) < 1000
        client.portal.call(director.go.set)
        wait_for(client, location, "awaiting_accept")
        waiting = of(client)
        assert (waiting["state"], waiting["grade"], waiting["moves"]) == ("awaiting_accept", "watch", False)
        client.post(f"{location}/actions", json={"type": "accept"})
        done = of(client)
        assert (done["status"], done["state"], done["run"]) == ("ready", "succeeded", run["id"])


def test_a_store_that_hangs_keeps_no_state_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with running(tmp_path, Director(held_in="running")) as (client, _):
        wait_for(client, start(client), "running")
        store = client.app.state.service.store  # type: ignore[attr-defined]
        for name in ("run", "runs", "approvals", "model"):
            monkeypatch.setattr(store, name, lambda *_, **__: time.sleep(3.0))
        began = time.monotonic()
        assert of(client)["moves"]
        assert time.monotonic() - began < 1.0


def test_a_stop_of_all_says_for_each_cell_whether_something_moved_until_nothing_does(tmp_path: Path) -> None:
    with running(tmp_path, Director(held_in="running"), cells=two_cells(tmp_path)) as (client, _):
        location = start(client, "two")
        wait_for(client, location, "running")
        first = {a["cell"]: a for a in client.post(STOP).json()["cells"]}
        assert (first["one"]["stopping"], first["one"]["moved"]) == (False, False)
        assert (first["two"]["stopping"], first["two"]["moved"]) == (True, True)
        assert first["two"]["identification"] == location.rsplit("/", 1)[1]
        assert "not a safety function" in first["two"]["note"]
        deadline = time.monotonic() + 10
        while any(a["stopping"] for a in client.post(STOP).json()["cells"]):
            assert time.monotonic() < deadline
        assert client.get(location).json()["state"] == "stopped"
        assert of(client, "two")["moves"] is False
