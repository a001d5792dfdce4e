"""Schemathesis over the whole OpenAPI with the simulated cell behind it: no 5xx, no schema violation."""

import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis.errors import Unsatisfiable
from service_process import serving

pytestmark = pytest.mark.service
EXAMPLES = int(os.environ.get("INVID_SCHEMA_EXAMPLES", "8"))
"""For each call and mode, once with made-up names and once with the cell and the run that exist."""
PATIENCE_S = 60.0
"""The first look at a simulation loads the simulated drives: seconds on a busy machine."""


def try_out(operation: Any, mode: Any, known: dict[str, str], tried: list[int]) -> None:
    """A handful of requests for one call, each answer checked against the document."""
    # Here, as every worker of `make test` collects this file and runs nothing of it: a second each.
    import schemathesis
    from schemathesis.specs.openapi import checks

    promised = [
        schemathesis.checks.not_a_server_error,
        checks.status_code_conformance,
        checks.content_type_conformance,
        checks.response_schema_conformance,
        checks.response_headers_conformance,
    ]

    @given(case=operation.as_strategy(generation_mode=mode))
    @settings(
        max_examples=EXAMPLES,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.explicit, Phase.generate],
    )
    def check(case: Any) -> None:
        response = case.call_and_validate(checks=promised, timeout=PATIENCE_S)
        tried[response.status_code] = tried[response.status_code] + 1
        if set(case.path_parameters or {}) & set(known):
            case.path_parameters.update({k: v for k, v in known.items() if k in case.path_parameters})
            response = case.call_and_validate(checks=promised, timeout=PATIENCE_S)
            tried[response.status_code] = tried[response.status_code] + 1

    check()


@pytest.mark.panel
@pytest.mark.campaign
def test_no_request_that_schemathesis_makes_up_breaks_the_schema_or_the_service(tmp_path: Path) -> None:
    import schemathesis
    from schemathesis.generation import GenerationMode

    with serving(tmp_path) as service:
        location = service.start(arm=False)
        service.wait(location, "awaiting_arm")
        known = {"cell": "small", "identification": location.rsplit("/", 1)[1]}
        schema = schemathesis.openapi.from_url(f"{service.url}/api/v1/openapi.json")
        tried = [0] * 600
        calls = 0
        for result in schema.get_all_operations():
            operation = result.ok()
            if operation.path.endswith("/events"):
                continue  # a stream that stays open while the run waits; it has tests of its own
            for mode in GenerationMode:
                try:
                    try_out(operation, mode, known, tried)
                except Unsatisfiable:
                    continue  # a call without parameters has no wrong ones
            calls += 1
        assert calls >= 24
        assert sum(tried[500:]) == 0
        assert sum(tried[200:300]) > 50
        assert sum(tried[400:500]) > 50
        assert service.client.get("/health/ready").status_code == 200
