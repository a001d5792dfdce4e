"""What a poll carries: the large parts of a run stand at addresses of their own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from service_doubles import Director, model_document, running, wait_for

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
