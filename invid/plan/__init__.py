"""Experiments as data, limits, dry run, bus budget."""

from invid.plan.budget import BusBudget, bus_budget, bus_load, frame_bits, require_budget
from invid.plan.build import default_experiments, make_plan
from invid.plan.model import AxisForecast, Plan, PlannedExperiment

__all__ = [
    "AxisForecast",
    "BusBudget",
    "Plan",
    "PlannedExperiment",
    "bus_budget",
    "bus_load",
    "default_experiments",
    "frame_bits",
    "make_plan",
    "require_budget",
]
