"""The budget of an analysis ends before the watchdog takes it for hung."""

from invid_service.jobs.protocol import Job
from invid_service.settings import Settings


def test_an_analysis_ends_with_its_best_answer_before_the_service_takes_it_for_hung() -> None:
    assert 60.0 <= Job.budget_s < Settings.model_fields["analysis_timeout_s"].default
