"""Which cell of a database left its own population, through REST."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from service_doubles import Director, model_document, running

from invid_service.jobs.states import State
from invid_service.store.store import RunRecord, Store, StoredModel

CALL = "/api/v1/departures"


def noisy(rng: np.random.Generator, *, softer: bool = False) -> str:
    """A run of the test cell: all numbers scatter by their standard deviation of 0.1 %."""
    document: dict[str, Any] = model_document(std=1e-3)
    for branch in document["branches"]:
        for kind in ("masses", "springs", "dampers"):
            for estimate in branch[kind]:
                estimate["value"] *= 1 + 1e-3 * rng.standard_normal()
    if softer:
        document["branches"][1]["springs"][0]["value"] *= 0.98
    return json.dumps(document)


def keep(store: Store, cell: str, week: int, document: str, mode: str = "full") -> None:
    """A model of a run that ended."""
    when = datetime(2026, 1, 5, tzinfo=UTC) + timedelta(weeks=week)
    run = f"{cell}-{week}"
    record = RunRecord(run, cell, "robot", mode, (), True, State.SUCCEEDED, when, "test")
    store.add_run(record)
    store.add_model(StoredModel(run, cell, when, mode, document))


def test_the_cell_that_changed_is_named_among_many(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    with running(tmp_path, Director()) as (client, _):
        assert client.get(CALL).json()["departures"] == []
        store = client.app.state.service.store  # type: ignore[attr-defined]
        for cell in range(12):
            for week in range(12):
                keep(store, f"cell{cell}", week, noisy(rng, softer=cell == 5 and week >= 9))
        keep(store, "cell3", 13, noisy(rng, softer=True), mode="simulate")
        keep(store, "cell4", 13, "damaged")
        found = client.get(CALL).json()
        assert (found["cells"], found["runs"], found["simulated"]) == (12, 144, True)
        assert found["false_alarm_rate"] == 1e-3
        (one,) = found["departures"]
        assert (one["cell"], one["parameter"]) == ("cell5", "A2.spring.1")
        assert one["since"]["model"] == "cell5-9"
        assert one["after"] / one["before"] < 0.99
        assert "cell5: A2.spring.1 left its own population" in one["sentence"]
        assert client.get(CALL, params={"last": 2}).json()["runs"] < 26
        assert client.get(CALL, params={"last": 1}).status_code == 422
        assert client.get(CALL, params={"weeks": 5}).status_code == 422
