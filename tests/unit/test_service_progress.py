"""What an analysis tells of its progress reaches the run's events; its budget ends before the watchdog."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from invid import Progress
from invid_service.jobs.protocol import Job
from invid_service.jobs.worker import _telling
from invid_service.settings import Settings


class Heard:
    """The worker's line, kept."""

    def __init__(self) -> None:
        self.said: list[tuple[float, str, dict[str, Any]]] = []

    def progress(self, fraction: float, phase: str, **members: Any) -> None:
        self.said.append((fraction, phase, members))


def test_what_is_weighed_is_passed_on_in_words_as_a_share_of_the_whole_run() -> None:
    heard = Heard()
    told = _telling(heard, 0.88, 0.96)  # type: ignore[arg-type]
    told(Progress("weighing", "A2", "backlash", 0.5, 12.0, "spring 1"))
    ((fraction, phase, members),) = heard.said
    assert round(fraction, 6) == 0.92
    assert phase == "weighing backlash, A2 spring 1"
    assert members == {"axis": "A2", "eta_s": 12.0}


def test_an_analysis_ends_with_its_best_answer_before_the_service_takes_it_for_hung() -> None:
    job = Job(
        id="1",
        kind="analyse",
        mode="upload",
        folder=Path("."),
        simulated=True,
        memory_bytes=1,
        stop_grace_s=1.0,
    )
    assert 60.0 <= job.budget_s < Settings.model_fields["analysis_timeout_s"].default
