"""Healthy cells as a user would describe them, measured by the default plan; the truth is the plant's own.

Nothing is tuned and nothing broken: half of rated torque, a window of ±0.5 rad and 3 rad/s, whatever masses,
springs, friction and loads stand behind; cycles, bit rates and drives with and without 0x1016 as they come.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from invid.config import CellConfig
from invid.errors import InvidError
from invid.numerics.arrays import Float64
from invid.planning import Plan
from invid.planning.stopping_distance import StoppingBudget
from invid.recording import Recording, read_recording
from invid_drivers.connect import connect
from invid_drivers.measurement import run_measurement
from invid_drivers.readiness import ask
from invid_drivers.simulated import kernel
from invid_drivers.simulated.cell import SimulatedCell
from invid_drivers.stopping_budgets import Wish


def ordinary(seed: int) -> CellConfig:
    """One healthy cell of one to three axes."""
    rng = np.random.default_rng([seed, 34])
    count = int(rng.integers(1, 4))
    cycle = float(rng.choice([0.001, 0.001, 0.001, 0.002, 0.004]))
    bitrate = int(rng.choice([1_000_000, 500_000] if cycle > 0.001 and count < 3 else [1_000_000]))
    branches, axes, drives = [], [], {}
    for i in range(count):
        name = f"A{i + 1}"
        size = int(rng.integers(1, 4))
        inertia = float(10 ** rng.uniform(-1.0, 1.3))
        masses = inertia * rng.dirichlet(np.full(size, 8.0))
        pair = masses[:-1] * masses[1:] / (masses[:-1] + masses[1:])
        springs = pair * (2 * np.pi * rng.uniform(2.0, 8.0, size - 1)) ** 2
        dampers = 2 * 10 ** rng.uniform(-2.3, -1.3) * np.sqrt(springs * pair)
        branches.append(
            {
                "axis": name,
                "masses": masses.tolist(),
                "springs": springs.tolist(),
                "dampers": dampers.tolist(),
            }
        )
        limit = inertia * 10 ** float(rng.uniform(0.5, 1.4))
        rated = 2 * limit
        loaded = rng.random() < 0.2
        watches = rng.random() < 0.85
        drives[name] = {
            "encoder_counts_per_rev": float(2 ** rng.integers(17, 21)),
            "torque_noise_fraction_of_rated": 0.005,
            "position_loop_Hz": float(rng.uniform(10, 30)),
            "friction": {
                "coulomb": rated * float(rng.uniform(0.001, 0.01)),
                "viscous": inertia * float(rng.uniform(0.0, 0.1)),
            },
            "quick_stop_deceleration_rad_per_s2": float(10 ** rng.uniform(0.7, 1.7)),
            "load": {"torque": float(rng.uniform(0.1, 0.3)) * limit * loaded},
            "objects": {"lacks": [] if watches else ["0x1016"]},
        }
        axis: dict[str, Any] = {
            "name": name,
            "node_id": i + 1,
            "rated_torque_Nm": round(rated, 3),
            "gravity_loaded": bool(loaded),
            "limits": {
                "torque_Nm": round(limit, 3), "position_window_rad": 0.5, "velocity_rad_per_s": 3.0,
            },
        }  # fmt: skip
        if not watches:
            axis["allow_missing_heartbeat"] = True
        if rng.random() < 0.6:
            axis["inertia_kgm2"] = round(inertia * float(rng.uniform(0.8, 1.25)), 4)
        axes.append(axis)
    ends = [b["masses"][-1] for b in branches]
    couplings = [
        {
            "between": [f"A{i + 1}", f"A{j + 1}"],
            "value": float(rng.uniform(-0.3, 0.3) * min(ends[i], ends[j])),
        }
        for j in range(count)
        for i in range(j)
    ]
    return CellConfig.model_validate(
        {
            "format": "invid-config",
            "robot": f"ordinary {seed}",
            "bus": {
                "interface": "invid-virtual", "channel": f"ordinary-{seed}", "cycle_s": cycle,
                "bitrate_bit_per_s": bitrate,
            },
            "axes": axes,
            "simulation": {
                "seed": seed,
                "plant": {"branches": branches, "couplings": couplings},
                "axes": drives,
            },
        }
    )  # fmt: skip


@dataclass
class Measured:
    """What was announced for a cell, and what its plant did."""

    config: CellConfig
    error: str = ""
    """What refused or ended it."""
    plan: Plan | None = None
    budgets: tuple[StoppingBudget, ...] = ()
    peaks: Float64 = field(default_factory=lambda: np.zeros((3, 0)))
    """(3, M) largest true travel, velocity and torque."""
    recording: Recording | None = None

    @property
    def announced(self) -> Float64:
        """(3, M) travel, velocity and torque of the dry run."""
        told = [] if self.plan is None else self.plan.forecast
        return np.array([[f.travel, f.velocity, f.peak_torque] for f in told]).T

    @property
    def limits(self) -> Float64:
        """(3, M) of the config as its user wrote it."""
        axes = [a.limits for a in self.config.axes]
        return np.array([[a.position, a.velocity, a.torque] for a in axes]).T


def measure(config: CellConfig) -> Measured:
    """Dry run, then the whole run in virtual time."""
    found = Measured(config, peaks=np.zeros((3, len(config.axes))))
    try:
        dry = ask(config).require()
        found.plan, found.budgets = dry.plan, dry.budgets
        cell = connect(config)
        bus: Any = cell.link.bus
        _observe(found, cell, bus.cell)
        with tempfile.TemporaryDirectory() as place:
            out = Path(place) / "rec.h5"
            run_measurement(config, Wish(), cell, out)
            found.recording = read_recording(out)
    except InvidError as error:
        found.error = f"exit {error.exit_code}: {error}"
    return found


def _observe(found: Measured, cell: Any, simulated: SimulatedCell) -> None:
    """Keep the largest true motion and torque of every cycle."""
    plant, tick = simulated.plant, cell.tick
    motors = plant.structure.motors
    origin = plant.positions[motors].copy()

    def watched(wish: Any) -> Any:
        sample = tick(wish)
        seen = np.abs(
            [plant.positions[motors] - origin, plant.velocities[motors], plant.motor_state[:, kernel.ACTING]]
        )
        np.maximum(found.peaks, seen, out=found.peaks)
        return sample

    cell.tick = watched
