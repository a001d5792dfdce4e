"""What a person said before a run is answered first; who decides is kept; a short check replaces no model."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import service_doubles
from fastapi.testclient import TestClient
from service_doubles import START, Director, model_document, start, wait_for

from invid.wording.sentence import as_sentences, say
from invid_service.keys import add_key

TOOL = {"what": "tool", "axis": "A2", "mass_kg": 1.3, "arm_m": 1.0}
HEAVIER = 1.31 / 6.0  # of the final mass of A2


@contextmanager
def running(folder: Path, **given: Any) -> Iterator[tuple[TestClient, Director]]:
    """A service whose scripted runs end with a diagnosis that found nothing beside the director's model."""
    director = Director()
    director.diagnosis = lambda: {
        "format_version": 1,
        "residual": [],
        "explained_fraction": 1.0,
        "unexplained": None,
        "warnings": [],
        "model": director.model(),
    }
    with service_doubles.running(folder, director, **given) as (client, _):
        yield client, director


def run(client: TestClient, state: str = "awaiting_accept", **body: Any) -> str:
    location = start(client, **body)
    wait_for(client, location, state)
    return location


def accept(client: TestClient, location: str, **more: Any) -> dict[str, Any]:
    answer = client.post(f"{location}/actions", json={"type": "accept", **more})
    assert answer.status_code == 200, answer.text
    body: dict[str, Any] = answer.json()
    return body


@pytest.mark.parametrize(
    ("said", "answer", "first"),
    [
        (TOOL, "as_said", "As you said, new load on A2: +1.3"),
        ({**TOOL, "mass_kg": -1.3}, "opposite", "The other way round than you said"),
        ({"inertia_kgm2": 0.3}, "more", "More than you said (another tool, about +0.3 kg·m²), new load"),
    ],
)
def test_a_tool_change_is_answered_by_what_was_said_of_it(
    tmp_path: Path, said: dict[str, Any], answer: str, first: str
) -> None:
    with running(tmp_path) as (client, director):
        accept(client, run(client))
        director.model = lambda: model_document(scale_mass=1 + HEAVIER)
        location = run(client, changed=said)
        body = client.get(location).json()
        diagnosis = client.get(f"{location}/diagnosis").json()
    assert body["changed"] == {"what": "tool", "axis": None, "mass_kg": None, "arm_m": None,
                               "inertia_kgm2": None, **said}  # fmt: skip
    assert body["summary"]["answer"] == answer
    assert body["summary"]["headline"].startswith(first)
    assert diagnosis["headline"] == body["summary"]["headline"]
    assert say(as_sentences(body)["summary"]["headline"], "de") != body["summary"]["headline"]


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ({"axis": "A9"}, "no axis 'A9'"),
        ({"mass_kg": 1.0, "inertia_kgm2": 1.0}, "not both"),
        ({"arm_m": 1.0}, "give mass_kg too"),
        ({"mass_kg": 0.0}, "is 0"),
        ({"what": "transmission", "mass_kg": 1.0}, "is of a tool"),
        ({"what": "gripper"}, "what"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_name(tmp_path: Path, said: dict[str, Any], why: str) -> None:
    with running(tmp_path) as (client, director):
        answer = client.post(START, json={"mode": "full", "changed": said})
        assert answer.status_code == 422
        assert why in answer.text
        assert director.workers == []


def test_who_accepts_is_named_in_decision_history_and_audit(tmp_path: Path) -> None:
    keys = tmp_path / "keys.json"
    key = add_key(keys, "tablet 3", ["read", "run", "accept", "admin"])
    with running(tmp_path, key_file=keys) as (client, director):
        client.headers["Authorization"] = f"Bearer {key}"
        first, second = run(client), run(client)
        decision = accept(client, first, by="auto")["decision"]
        assert (decision["by"], decision["caller"]) == ("auto", "tablet 3")
        assert accept(client, second)["decision"]["by"] == "tablet 3"
        restored = f"/api/v1/cells/cell/models/{first.rsplit('/', 1)[1]}/restore"
        assert client.post(restored, json={"by": "Ann Weld"}).status_code == 200
        history = client.get("/api/v1/cells/cell/models").json()["history"]
        # A person of that name is not the service, which accepts within its bounds by itself.
        assert [(h["by"], h["how"]) for h in history] == [
            ("Ann Weld", "restore"), ("tablet 3", "accept"), ("auto", "accept"),
        ]  # fmt: skip
        audit = [(e["action"], e["caller"], e.get("by")) for e in client.get("/api/v1/audit").json()]
        assert ("accept", "tablet 3", "auto") in audit
        assert ("restore", "tablet 3", "Ann Weld") in audit
        for by in ("", " ", "a\nb", "a\x00b", "x" * 81):
            assert client.post(f"{second}/actions", json={"type": "accept", "by": by}).status_code == 422
        assert len(director.workers) == 2


def test_a_short_check_compares_with_the_accepted_model_and_replaces_none(tmp_path: Path) -> None:
    with running(tmp_path) as (client, director):
        refused = client.post(START, json={"mode": "screen"})
        assert refused.status_code == 409
        assert [r["code"] for r in refused.json()["reasons"]] == ["nothing_to_screen"]
        first = run(client)
        accept(client, first)
        director.model = lambda: model_document(scale_mass=1 + HEAVIER)
        location = run(client, "succeeded", mode="screen", changed=TOOL)
        body = client.get(location).json()
        assert director.workers[-1].job.mode == "screen"
        assert director.workers[-1].job.model is not None
        assert body["summary"]["headline"].startswith("As you said, new load on A2")
        assert body["summary"]["headline"].endswith("Measure in full to take it over.")
        assert client.get("/api/v1/cells/cell/model").json()["id"] == first.rsplit("/", 1)[1]
        answer = client.post(f"{location}/actions", json={"type": "accept"})
        assert answer.status_code == 409
        narrow = client.post(START, json={"mode": "screen", "axes": ["A1"]})
        assert narrow.status_code == 422
