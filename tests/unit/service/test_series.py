"""Changes of causes and the history of one number, through REST."""

import csv
import io
from pathlib import Path
from typing import Any

import pytest
from service_doubles import Director, model_document, running, start, wait_for

from invid.wording.sentence import as_sentences, say

API = "/api/v1/cells/cell"
PLAY = {"cause": "backlash", "axis": "A2", "element": "spring 1"}


def document(gap: float | None, verdict: str = "explained") -> dict[str, Any]:
    """The test cell's model, with free play or without."""
    made = model_document()
    made["fit"] = {"verdict": verdict}
    if gap is not None:
        sizes = {"gap": {"value": gap, "std": 1e-5, "unit": "rad"}}
        made["effects"] = [{**PLAY, "parameters": sizes}]
    return made


def accept(client: Any, director: Director, made: dict[str, Any]) -> dict[str, Any]:
    """One run whose result is ``made``, accepted; the run as it awaited that."""
    director.model = lambda: made
    location = start(client)
    run = wait_for(client, location, "awaiting_accept")
    client.post(f"{location}/actions", json={"type": "accept"})
    return run


@pytest.mark.campaign
def test_a_cause_that_appears_is_in_the_headline_and_in_the_changes(tmp_path: Path) -> None:
    with running(tmp_path) as (client, director):
        accept(client, director, document(None))
        run = accept(client, director, document(3e-4))
        headline = run["summary"]["headline"]
        assert headline.startswith("New: free play in the transmission on A2 at spring 1, 0.30 ± 0.01 m")
        german = say(as_sentences(run)["summary"]["headline"], "de")
        assert german.startswith("Neu: Spiel im Getriebe an A2, Feder 1, 0,30 ± 0,01 mrad.")
        (cause,) = client.get(f"{API}/changes").json()["causes"]
        assert (cause["name"], cause["status"]) == ("A2.backlash.spring 1", "appeared")
        assert cause["from"] is None
        assert cause["to"]["value"] == 3e-4


@pytest.mark.campaign
def test_the_history_of_a_parameter_and_of_a_cause_is_a_series_in_json_and_csv(tmp_path: Path) -> None:
    with running(tmp_path) as (client, director):
        for gap in (None, 3e-4, 5e-4):
            accept(client, director, document(gap))
        play = client.get(f"{API}/series", params={"parameter": "A2.backlash.spring 1"}).json()
        assert [p["value"] for p in play["points"]] == [None, 3e-4, 5e-4]
        assert [p["std"] for p in play["points"]] == [None, 1e-5, 1e-5]
        assert (play["unit"], play["simulated"]) == ("rad", True)
        assert all(p["accepted"] for p in play["points"])
        mass = client.get(f"{API}/series", params={"parameter": "A2.mass.3", "format": "csv"})
        assert mass.headers["content-type"].startswith("text/csv")
        rows = list(csv.reader(io.StringIO(mass.text)))
        assert rows[0][4:] == ["A2.mass.3 [kg·m²]", "std [kg·m²]"]
        assert len(rows) == 4
        assert abs(float(rows[1][4]) - 6.0) < 0.01
        asked = client.get(f"{API}/series", params={"parameter": "A2.mass.3"}, headers={"Accept": "text/csv"})
        assert asked.text == mass.text
