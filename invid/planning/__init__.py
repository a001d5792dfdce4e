"""Experiments as data, limits, dry run, bus budget."""

from invid.config.frames import frame_bits
from invid.planning.budget import BusBudget, bus_budget, bus_load, require_budget
from invid.planning.build import make_plan
from invid.planning.model import AxisForecast, Plan, PlannedExperiment

__all__ = [
    "AxisForecast",
    "BusBudget",
    "Plan",
    "PlannedExperiment",
    "bus_budget",
    "bus_load",
    "frame_bits",
    "make_plan",
    "require_budget",
]
