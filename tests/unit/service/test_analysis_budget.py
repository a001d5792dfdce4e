"""The budget of an analysis ends before the watchdog takes it for hung."""

from __future__ import annotations

from pathlib import Path

from service_doubles import running, wait_for

from invid_service.jobs.protocol import Job
from invid_service.settings import Settings


def test_an_analysis_ends_with_its_best_answer_before_the_service_takes_it_for_hung() -> None:
    job = Job(
        id="1",
        kind="analyse",
        mode="upload",
        requested_by="plc",
        folder=Path("."),
        simulated=True,
        memory_bytes=1,
        stop_grace_s=1.0,
    )
    assert 60.0 <= job.budget_s < Settings.model_fields["analysis_timeout_s"].default


def test_the_budget_follows_the_time_that_the_service_allows(tmp_path: Path) -> None:
    with running(tmp_path, analysis_timeout_s=30.0) as (client, director):
        started = client.post("/api/v1/cells/cell/identifications", json={"mode": "test", "arm": True})
        wait_for(client, started.headers["Location"], "awaiting_accept")
        job = director.workers[0].job
        assert 20.0 <= job.budget_s < 30.0
        assert job.requested_by == client.get(started.headers["Location"]).json()["requested_by"]
