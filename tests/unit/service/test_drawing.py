"""``GET /identifications/{id}/drawing``: the model with its findings and what changed, in two languages."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest
from service_doubles import Director, model_document, running, wait_for

API = "/api/v1/cells/cell"


def run(client, director, made) -> str:
    director.model = lambda: made
    location = client.post(f"{API}/identifications", json={"mode": "full", "arm": True}).headers["Location"]
    wait_for(client, location, "awaiting_accept")
    return location


@pytest.mark.campaign
def test_the_drawing_shows_the_model_and_what_changed_since_the_one_in_force(tmp_path: Path) -> None:
    with running(tmp_path, Director()) as (client, director):
        first = run(client, director, model_document())
        svg = client.get(f"{first}/drawing")
        assert svg.status_code == 200
        assert svg.headers["content-type"] == "image/svg+xml"
        assert "Δ" not in svg.text
        client.post(f"{first}/actions", json={"type": "accept"})
        second = run(client, director, model_document(scale_mass=1.12))
        root = ElementTree.fromstring(client.get(f"{second}/drawing").text)
        texts = [t.text or "" for t in root.iter("{http://www.w3.org/2000/svg}text")]
        assert "Δ +12 %" in texts
        assert sum(t.startswith("Δ") for t in texts) == 1


def test_a_run_without_a_model_has_no_drawing(tmp_path: Path) -> None:
    director = Director()
    director.failure = {"code": "x", "text": "x", "fix": "x"}
    with running(tmp_path, director) as (client, _):
        location = client.post(f"{API}/identifications", json={"mode": "full", "arm": True}).headers[
            "Location"
        ]
        wait_for(client, location, "failed")
        answer = client.get(f"{location}/drawing")
        assert answer.status_code == 404
        assert answer.json()["type"] == "urn:invid:problem:artefact-not-found"
