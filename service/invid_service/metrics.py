"""Prometheus metrics of one application."""

from __future__ import annotations

from collections.abc import Callable

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest


class Metrics:
    """Own registry: two applications in one process do not share counts."""

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

    def ended(self, state: str, mode: str) -> None:
        """Count an ended run."""
        self._ended.labels(state, mode).inc()

    def stopped(self, cell: str) -> None:
        """Count a stop."""
        self._stops.labels(cell).inc()

    def answered(self, method: str, status: int, seconds: float) -> None:
        """Time of an answer."""
        known = method if method in ("GET", "POST", "PATCH", "HEAD") else "other"
        self._seconds.labels(known, str(status)).observe(seconds)

    def text(self) -> bytes:
        """The exposition."""
        return generate_latest(self.registry)
