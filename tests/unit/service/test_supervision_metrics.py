"""Gauges of the cells, and a dashboard that asks for nothing that is not there."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from prometheus_client.parser import text_string_to_metric_families
from service_doubles import Director, running, wait_for

DEPLOY = Path(__file__).parents[3] / "deploy"
START = {"mode": "full", "arm": True}
FUNCTIONS = {"sum", "by", "rate", "increase", "or", "vector", "label_replace", "label_values", "le"} | {
    "histogram_quantile",
    "state",
    "cell",
    "grade",
}
"""Words of the query language, and labels that it groups by."""


def samples(text: str) -> dict[str, dict[tuple[str, ...], float]]:
    """Values by name of the sample and values of its labels, in the order of their names."""
    found: dict[str, dict[tuple[str, ...], float]] = {}
    for family in text_string_to_metric_families(text):
        for s in family.samples:
            values = tuple(value for _, value in sorted(s.labels.items()))
            found.setdefault(s.name, {})[values] = s.value
    return found


def queries() -> Iterator[str]:
    """Every query of the dashboard."""
    board = json.loads((DEPLOY / "grafana" / "invid.json").read_text(encoding="utf-8"))

    def within(node: Any) -> Iterator[str]:
        if isinstance(node, dict):
            yield from (node[k] for k in ("expr", "definition") if isinstance(node.get(k), str))
            for value in node.values():
                yield from within(value)
        elif isinstance(node, list):
            for value in node:
                yield from within(value)

    yield from within(board)


def asked_for(query: str) -> set[str]:
    """Names of metrics in a query: what stands outside quotes and braces and is no word of the language."""
    bare = re.sub(r'"[^"]*"|\{[^}]*\}|\[[^\]]*\]', " ", query)
    return set(re.findall(r"\b[a-z_]+\b", bare)) - FUNCTIONS


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
        location = client.post("/api/v1/cells/cell/identifications", json=START).headers["Location"]
        wait_for(client, location, "awaiting_accept")
        now = samples(client.get("/metrics").text)
        states = {state for (_, state), value in now["invid_cell_state"].items() if value == 1}
        assert states == {"awaiting_accept"}
        assert now["invid_cell_grade"][("cell", "watch")] == 1
        assert sum(now["invid_cell_grade"].values()) == 1
        assert 0 <= now["invid_cell_last_run_age_seconds"][("cell",)] < 60
        director.go.clear()
        client.post("/api/v1/cells/cell/identifications", json=START)
        moving = samples(client.get("/metrics").text)
        assert moving["invid_cell_state"][("cell", "awaiting_accept")] == 0
        assert moving["invid_cell_grade"][("cell", "watch")] == 1  # of the last result


def test_the_dashboard_asks_for_metrics_that_there_are(tmp_path: Path) -> None:
    with running(tmp_path) as (client, _):
        location = client.post("/api/v1/cells/cell/identifications", json=START).headers["Location"]
        wait_for(client, location, "awaiting_accept")
        client.post(f"{location}/actions", json={"type": "accept"})
        client.post("/api/v1/cells/cell/stop")
        there = set(samples(client.get("/metrics").text))
    asked = [asked_for(query) for query in queries()]
    assert len(asked) >= 12
    assert all(asked)
    assert set().union(*asked) <= there
    assert {
        "invid_cell_state",
        "invid_cell_grade",
        "invid_cell_last_run_age_seconds",
        "invid_build_info",
    } <= (set().union(*asked))


def test_the_scrape_configuration_asks_where_the_metrics_are(tmp_path: Path) -> None:
    (job,) = yaml.safe_load((DEPLOY / "prometheus" / "invid.yml").read_text())["scrape_configs"]
    with running(tmp_path) as (client, _):
        assert client.get(job["metrics_path"]).headers["content-type"].startswith("text/plain; version=0.0.4")
