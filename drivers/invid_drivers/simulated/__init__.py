"""Simulated drives on a plant: a virtual-time bus, and the same drives in real time."""

from __future__ import annotations

from pathlib import Path

from invid_drivers.simulated.bus import VirtualTimeBus, open_virtual_bus
from invid_drivers.simulated.config import SimulationConfig, simulation_of, truth
from invid_drivers.simulated.simcell import run_simcell

CASE_STUDY = Path(__file__).with_name("case_study.yaml")
"""Config of the paper's case study as a simulated cell."""

__all__ = [
    "CASE_STUDY",
    "SimulationConfig",
    "VirtualTimeBus",
    "open_virtual_bus",
    "run_simcell",
    "simulation_of",
    "truth",
]
