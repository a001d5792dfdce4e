"""Run a plan against ports: move the axes, watch their limits, always stop."""

from invid.sweep.cell import Cell
from invid.sweep.engine import Progress, Sweep, SweepResult
from invid.sweep.ports import Clock, Event, Mode, Sample, Severity, Sink

__all__ = [
    "Cell",
    "Clock",
    "Event",
    "Mode",
    "Progress",
    "Sample",
    "Severity",
    "Sink",
    "Sweep",
    "SweepResult",
]
