"""The shell that moves things: runs a plan against ports, watches limits, always stops."""

from invid.sweep.engine import Progress, Sweep, SweepResult
from invid.sweep.ports import Cell, Clock, Event, Mode, Sample, Severity, Sink

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
