"""``/identifications/{id}/tuning``: values from a finished run's model, in a process of their own."""

import io
import time
import zipfile
from pathlib import Path
from typing import Any

import pytest
from service_doubles import START, Director, model_document, running, started
from starlette.testclient import TestClient

PATIENCE_S = 180.0


def small_model() -> dict[str, Any]:
    """The case study with its first axis alone: seconds to tune."""
    document = model_document()
    document["branches"], document["couplings"] = document["branches"][:1], []
    document.pop("covariance")
    return document


def small_diagnosis() -> dict[str, Any]:
    return {
        "format_version": 1,
        "residual": [],
        "explained_fraction": None,
        "unexplained": None,
        "model": small_model(),
    }


def finished(client: TestClient) -> str:
    return started(client)


def tuned(client: TestClient, location: str) -> Any:
    """The answer once it no longer says that it goes on."""
    deadline = time.monotonic() + PATIENCE_S
    while (answer := client.get(f"{location}/tuning")).status_code == 202:
        assert answer.json() == {"state": "running", "simulated": True}
        assert time.monotonic() < deadline
        time.sleep(0.2)
    return answer


def director_of_one_axis() -> Director:
    director = Director()
    director.model, director.diagnosis = small_model, small_diagnosis
    return director


@pytest.mark.campaign
def test_a_finished_run_is_tuned_and_its_files_are_kept(tmp_path: Path) -> None:
    with running(tmp_path, director_of_one_axis()) as (client, _):
        location = finished(client)
        assert client.get(f"{location}/tuning").status_code == 404
        wanted = {"model": location.rsplit("/", 1)[-1], "draws": 50}
        more = {"drive": "beckhoff_ax8000", "motors": {"A1": {"gear": 80}}}
        begun = client.post("/api/v1/models/tune", json={**wanted, **more})
        assert begun.status_code == 202
        assert begun.headers["Location"] == f"{location}/tuning"
        # asked again while it goes on, it is the same one
        assert client.post("/api/v1/models/tune", json=wanted).status_code == 202
        document = tuned(client, location).json()
        assert document["simulated"] is True
        assert document["axes"][0]["after"]["margins"]["sensitivity"] <= 2.0
        archive = zipfile.ZipFile(io.BytesIO(client.get(f"{location}/tuning-files").content))
        assert {"tuning.json", "tuning.html", "A1-beckhoff_ax8000.dcf"} <= set(archive.namelist())
        page = client.get(f"{location}/tuning-page")
        assert "sandbox" in page.headers["Content-Security-Policy"]
        assert client.get(f"{location}/tuning-picture").headers["content-type"] == "image/svg+xml"
        assert set(client.get(location).json()["links"]) >= {
            "tuning",
            "tuning-page",
            "tuning-picture",
            "tuning-files",
        }


@pytest.mark.campaign
def test_the_loops_are_measured_only_of_a_run_that_was_tuned(tmp_path: Path) -> None:
    with running(tmp_path, director_of_one_axis()) as (client, _):
        location = finished(client)
        model = location.rsplit("/", 1)[-1]
        assert client.post(START, json={"mode": "verify"}).status_code == 422
        assert client.post(START, json={"mode": "full", "tuned": model}).status_code == 422
        assert client.post(START, json={"mode": "verify", "tuned": model}).status_code == 409
