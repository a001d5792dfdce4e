"""The log of the service: where a run went, for whoever has only the log."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from service_doubles import Director, running, start, wait_for

from invid_service.logs import configure_logging


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
