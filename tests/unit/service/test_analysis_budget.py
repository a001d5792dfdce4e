"""The budget of an analysis ends before the watchdog takes it for hung."""

from __future__ import annotations

from pathlib import Path

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
