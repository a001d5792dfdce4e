"""Prometheus metrics of one application."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from threading import Lock

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

from invid import __version__
from invid.model.diagnosis_document import Grade
from invid_service.jobs.states import IDLE, State


@dataclass(frozen=True)
class CellFacts:
    """Facts of one cell for the metrics: its last measurement, in progress or ended."""

    cell: str
    state: State | None
    age_s: float | None
    """Since it was started."""
    grade: str | None
    """Of the last result."""


class Metrics:
    """Metrics in a registry of their own: two applications in one process do not share counts."""

    def __init__(self, active: Callable[[], int]) -> None:
        self.registry = CollectorRegistry()
        self._ended = Counter(
            "invid_identifications_ended_total",
            "Identifications by end state",
            ["state", "mode"],
            registry=self.registry,
        )
        self._stops = Counter("invid_stops_total", "Stops asked for", ["cell"], registry=self.registry)
        self._seconds = Histogram(
            "invid_http_request_seconds",
            "Time to the first byte of an answer",
            ["method", "status"],
            registry=self.registry,
            buckets=(0.001, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0, 5.0),
        )
        gauge = Gauge("invid_cells_busy", "Cells with a run in progress", registry=self.registry)
        gauge.set_function(active)
        self._state = self._gauge(
            "invid_cell_state", "1 for the state of the cell's last measurement, else 0", "state"
        )
        self._grade = self._gauge(
            "invid_cell_grade", "1 for the grade of the cell's last result, else 0", "grade"
        )
        self._age = self._gauge("invid_cell_last_run_age_seconds", "Since the cell's last measurement began")
        build = Gauge(
            "invid_build_info", "Always 1; what runs here", ["version", "python"], registry=self.registry
        )
        build.labels(__version__, platform.python_version()).set(1)
        self._looking = Lock()

    def _gauge(self, name: str, text: str, *labels: str) -> Gauge:
        return Gauge(name, text, ["cell", *labels], registry=self.registry)

    def ended(self, state: str, mode: str) -> None:
        """Count an ended run."""
        self._ended.labels(state, mode).inc()

    def stopped(self, cell: str) -> None:
        """Count a stop."""
        self._stops.labels(cell).inc()

    def answered(self, method: str, status: int, seconds: float) -> None:
        """Count an answer and its time."""
        known = method if method in ("GET", "POST", "PATCH", "HEAD") else "other"
        self._seconds.labels(known, str(status)).observe(seconds)

    def text(self, cells: Sequence[CellFacts]) -> bytes:
        """Return the exposition, with what is known of the cells now."""
        with self._looking:
            for gauge in (self._state, self._grade, self._age):
                gauge.clear()
            for facts in cells:
                for state in (IDLE, *State):
                    self._state.labels(facts.cell, state).set(state == (facts.state or IDLE))
                for grade in Grade:
                    self._grade.labels(facts.cell, grade).set(grade == facts.grade)
                if facts.age_s is not None:
                    self._age.labels(facts.cell).set(facts.age_s)
            return generate_latest(self.registry)
