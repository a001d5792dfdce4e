"""Gauges of the cells, and a dashboard that asks for nothing that is not there."""

from __future__ import annotations

from pathlib import Path

from prometheus_client.parser import text_string_to_metric_families
from service_doubles import Director, running, start, started

"""Words of the query language, and labels that it groups by."""


def samples(text: str) -> dict[str, dict[tuple[str, ...], float]]:
    """Values by name of the sample and values of its labels, in the order of their names."""
    found: dict[str, dict[tuple[str, ...], float]] = {}
    for family in text_string_to_metric_families(text):
        for s in family.samples:
            values = tuple(value for _, value in sorted(s.labels.items()))
            found.setdefault(s.name, {})[values] = s.value
    return found


def test_supervision_sees_state_grade_age_and_build(tmp_path: Path) -> None:
    director = Director()
    director.summary = {"grade": "watch"}
    with running(tmp_path, director) as (client, _):
        before = samples(client.get("/metrics").text)
        assert before["invid_cell_state"][("cell", "idle")] == 1
        assert "invid_cell_last_run_age_seconds" not in before
        assert sum(before["invid_cell_grade"].values()) == 0
        ((python, version),) = before["invid_build_info"]
        assert version == client.get("/version").json()["version"]
        assert python.startswith("3.")
        started(client)
        now = samples(client.get("/metrics").text)
        states = {state for (_, state), value in now["invid_cell_state"].items() if value == 1}
        assert states == {"awaiting_accept"}
        assert now["invid_cell_grade"][("cell", "watch")] == 1
        assert sum(now["invid_cell_grade"].values()) == 1
        assert 0 <= now["invid_cell_last_run_age_seconds"][("cell",)] < 60
        director.go.clear()
        start(client)
        moving = samples(client.get("/metrics").text)
        assert moving["invid_cell_state"][("cell", "awaiting_accept")] == 0
        assert moving["invid_cell_grade"][("cell", "watch")] == 1  # of the last result
