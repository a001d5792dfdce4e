"""What is told of every cell, in one answer, a small one, metrics and the log; the stop of all."""

import json
import logging
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families
from service_doubles import CELL, Director, running, start, started, until, wait_for

from invid_service.jobs.live import LiveRun
from invid_service.jobs.protocol import RunProgress
from invid_service.jobs.states import State
from invid_service.logs import configure_logging

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
        until(lambda: not any(a["stopping"] for a in client.post(STOP).json()["cells"]))
        assert client.get(location).json()["state"] == "stopped"
        assert of(client, "two")["moves"] is False


BUFFER = 1024
"""Bytes that the contract promises to a PLC."""


def state_of(client: Any, cell: str = "cell") -> dict[str, Any]:
    answer = client.get(f"/api/v1/cells/{cell}/state")
    assert answer.status_code == 200, answer.text
    assert len(answer.content) < BUFFER
    return dict(answer.json())


def test_the_state_fits_a_small_buffer_with_the_longest_names_that_there_are(tmp_path: Path) -> None:
    config = tmp_path / f"{'a cell with a very long name ' * 5}.yaml"
    config.write_text(CELL)
    director = Director()
    director.failure = {"code": "a-code-that-is-as-long-as-the-longest", "text": "x" * 4000, "fix": "y"}
    with running(tmp_path, director, cells=[config]) as (client, _):
        (cell,) = client.get("/api/v1/cells").json()["cells"]
        assert len(cell["id"]) == 64
        location = start(client, cell["id"])
        wait_for(client, location, "failed")
        assert state_of(client, cell["id"])["error"] == director.failure["code"]
        service = client.app.state.service
        record = service.store.run(location.rsplit("/", 1)[1])
        longest = LiveRun(replace(record, state=State.RUNNING, ended=None, id="9" * 40))
        for character in ("\U0001f916", "\x01"):  # four bytes; six where JSON escapes it
            longest.progress = RunProgress(
                progress=1 / 3,
                phase=character * 1000,
                axis="A" * 64,
                frequency=1 / 3,
                eta_s=1e9 / 3,
                motion_left_s=1e9 / 3,
            )
            service.jobs._latest[cell["id"]] = longest
            assert state_of(client, cell["id"])["phase"] == character * 60


"""Words of the query language, and labels that it groups by."""


def samples(text: str) -> dict[str, dict[tuple[str, ...], float]]:
    """Values by name of the sample and values of its labels, in the order of their names."""
    found: dict[str, dict[tuple[str, ...], float]] = {}
    for family in text_string_to_metric_families(text):
        for s in family.samples:
            values = tuple(value for _, value in sorted(s.labels.items()))
            found.setdefault(s.name, {})[values] = s.value
    return found


def test_supervision_sees_state_grade_age_and_build(tmp_path: Path) -> None:
    director = Director()
    director.summary = {"grade": "watch"}
    with running(tmp_path, director) as (client, _):
        before = samples(client.get("/metrics").text)
        assert before["invid_cell_state"][("cell", "idle")] == 1
        assert "invid_cell_last_run_age_seconds" not in before
        assert sum(before["invid_cell_grade"].values()) == 0
        ((python, version),) = before["invid_build_info"]
        assert version == client.get("/version").json()["version"]
        assert python.startswith("3.")
        started(client)
        now = samples(client.get("/metrics").text)
        states = {state for (_, state), value in now["invid_cell_state"].items() if value == 1}
        assert states == {"awaiting_accept"}
        assert now["invid_cell_grade"][("cell", "watch")] == 1
        assert sum(now["invid_cell_grade"].values()) == 1
        assert 0 <= now["invid_cell_last_run_age_seconds"][("cell",)] < 60
        director.go.clear()
        start(client)
        moving = samples(client.get("/metrics").text)
        assert moving["invid_cell_state"][("cell", "awaiting_accept")] == 0
        assert moving["invid_cell_grade"][("cell", "watch")] == 1  # of the last result


@pytest.fixture
def root_logger(monkeypatch: pytest.MonkeyPatch) -> Iterator[logging.Logger]:
    root = logging.getLogger()
    level = root.level
    monkeypatch.setattr(root, "handlers", list(root.handlers))
    yield root
    root.setLevel(level)


@pytest.mark.campaign
def test_the_log_holds_start_end_verdict_and_cell_of_every_run(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], root_logger: logging.Logger
) -> None:
    director = Director()
    director.summary = {"headline": "Dry friction on A1.", "grade": "watch"}
    director.verdict = "explained"
    configure_logging(json_lines=True)
    with running(tmp_path, director) as (client, _):
        accepted, failed = start(client), ""
        wait_for(client, accepted, "awaiting_accept")
        client.post(f"{accepted}/actions", json={"type": "accept"})
        director.failure = {"code": "drive", "text": "A2 does not answer", "fix": "look at its cable"}
        wait_for(client, failed := start(client), "failed")
        director.failure = None
        director.go.clear()
        wait_for(client, stopped := start(client), "running")
        client.post("/api/v1/cells/cell/stop")
        wait_for(client, stopped, "stopped")
    lines = [json.loads(line) for line in capfd.readouterr().err.splitlines()]

    def of(location: str) -> list[dict[str, Any]]:
        return [line for line in lines if line.get("run") == location.rsplit("/", 1)[1]]

    began, judged, ended = of(accepted)
    assert (began["event"], began["cell"], began["mode"], began["caller"]) == (
        "run began", "cell", "full", "local",
    )  # fmt: skip
    assert (judged["state"], judged["verdict"]) == ("awaiting_accept", "explained")
    assert (judged["grade"], judged["headline"]) == ("watch", "Dry friction on A1.")
    assert (ended["event"], ended["state"], ended["by"]) == ("run ended", "succeeded", "local")
    assert all(line["cell"] == "cell" and line["timestamp"] for line in (began, judged, ended))
    _, ended = of(failed)
    assert (ended["level"], ended["state"]) == ("warning", "failed")
    assert (ended["error"], ended["fix"]) == ("drive: A2 does not answer", "look at its cable")
    _, ended = of(stopped)
    assert (ended["level"], ended["state"], ended["cell"]) == ("warning", "stopped", "cell")
