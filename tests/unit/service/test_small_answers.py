"""What a poll carries: the large parts of a run stand at addresses of their own."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from service_doubles import CELL, Director, model_document, running, wait_for

from invid_service.jobs.live import LiveRun
from invid_service.jobs.protocol import Progress
from invid_service.jobs.states import State

SECOND = timedelta(seconds=1)
START = {"mode": "full", "arm": True}


def accepted_and_changed(client: Any, director: Director) -> str:
    """The second of two runs, between which the tool was changed; it awaits acceptance."""
    for scale in (1.0, 1.3):
        director.model = lambda scale=scale: model_document(scale_mass=scale)  # type: ignore[misc]
        location = str(client.post("/api/v1/cells/cell/identifications", json=START).headers["Location"])
        wait_for(client, location, "awaiting_accept")
        if scale == 1.0:
            client.post(f"{location}/actions", json={"type": "accept"})
    return location


@pytest.mark.campaign
def test_a_poll_carries_what_changed_and_the_link_carries_every_parameter(tmp_path: Path) -> None:
    with running(tmp_path) as (client, director):
        location = accepted_and_changed(client, director)
        answer = client.get(location)
        body = answer.json()
        assert len(answer.content) < 4096  # without the 23 parameters that did not change
        told = body["summary"]["changes"]
        assert [p["parameter"] for p in told["parameters"]] == ["A2.mass.3"]
        whole = client.get(body["links"]["changes"]).json()
        assert len(whole["parameters"]) == 24
        assert [p for p in whole["parameters"] if p["status"] == "changed"] == told["parameters"]
        assert whole["sentence"] == told["sentence"]
        assert whole["simulated"] is True
        listed = client.get("/api/v1/identifications").json()["identifications"][0]
        assert listed["summary"] == body["summary"]


def test_the_plan_is_in_the_body_until_it_has_moved_and_at_its_link_for_good(tmp_path: Path) -> None:
    with running(tmp_path) as (client, _):
        start = {**START, "arm": False}
        location = client.post("/api/v1/cells/cell/identifications", json=start).headers["Location"]
        assert client.get(f"{location}/measurement").status_code == 404
        plan = wait_for(client, location, "awaiting_arm")["plan"]
        client.post(f"{location}/actions", json={"type": "arm"})
        body = wait_for(client, location, "awaiting_accept")
        assert body["plan"] is None
        assert client.get(body["links"]["plan"]).json() == {**plan, "simulated": True}
        answer = client.get(f"{location}/changes")  # nothing was accepted before
        assert (answer.status_code, answer.json()["type"]) == (404, "urn:invid:problem:artefact-not-found")


BUFFER = 1024
"""Bytes that the contract promises to a PLC."""


def state_of(client: Any, cell: str = "cell") -> dict[str, Any]:
    answer = client.get(f"/api/v1/cells/{cell}/state")
    assert answer.status_code == 200, answer.text
    assert len(answer.content) < BUFFER
    return dict(answer.json())


def test_the_state_of_a_cell_follows_its_run_and_says_since_when(tmp_path: Path) -> None:
    director = Director()
    director.summary = {"grade": "act"}
    director.go.clear()
    with running(tmp_path, director) as (client, _):
        assert state_of(client) == {
            "cell": "cell", "state": "idle", "run": None, "since": None, "phase": "", "progress": 0.0,
            "eta_s": None, "motion_left_s": None, "error": None, "grade": None, "simulated": True,
        }  # fmt: skip
        before = datetime.now(UTC)
        location = client.post("/api/v1/cells/cell/identifications", json=START).headers["Location"]
        wait_for(client, location, "running")
        moving = state_of(client)
        assert (moving["state"], moving["run"]) == ("running", location.rsplit("/", 1)[1])
        assert before <= datetime.fromisoformat(moving["since"]) <= datetime.now(UTC)
        director.go.set()
        wait_for(client, location, "awaiting_accept")
        waiting = state_of(client)
        assert (waiting["state"], waiting["grade"], waiting["progress"]) == ("awaiting_accept", "act", 1.0)
        assert datetime.fromisoformat(waiting["since"]) > datetime.fromisoformat(moving["since"])
    with running(tmp_path) as (client, _):  # and over a restart
        kept = state_of(client)
        assert abs(datetime.fromisoformat(kept["since"]) - datetime.fromisoformat(waiting["since"])) < SECOND
        assert {**kept, "since": None} == {**waiting, "since": None}


def test_the_state_fits_a_small_buffer_with_the_longest_names_that_there_are(tmp_path: Path) -> None:
    config = tmp_path / f"{'a cell with a very long name ' * 5}.yaml"
    config.write_text(CELL)
    director = Director()
    director.failure = {"code": "a-code-that-is-as-long-as-the-longest", "text": "x" * 4000, "fix": "y"}
    with running(tmp_path, director, cells=[config]) as (client, _):
        (cell,) = client.get("/api/v1/cells").json()["cells"]
        assert len(cell["id"]) == 64
        run = client.post(f"/api/v1/cells/{cell['id']}/identifications", json=START)
        wait_for(client, run.headers["Location"], "failed")
        assert state_of(client, cell["id"])["error"] == director.failure["code"]
        service = client.app.state.service
        record = replace(service.store.run(run.json()["id"]), state=State.RUNNING, ended=None, id="9" * 40)
        longest = LiveRun(record)
        for character in ("\U0001f916", "\x01"):  # four bytes; six where JSON escapes it
            longest.progress = Progress(
                fraction=1 / 3,
                phase=character * 1000,
                axis="A" * 64,
                frequency=1 / 3,
                eta_s=1e9 / 3,
                motion_left_s=1e9 / 3,
            )
            service.jobs._latest[cell["id"]] = longest
            assert state_of(client, cell["id"])["phase"] == character * 60
