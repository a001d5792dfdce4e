"""Random healthy cells behind simulated drives, and what their plants truly did in every phase of a run.

Masses, springs, damping, friction, couplings, encoders, limits and holds are drawn; nothing is broken. The
truth is read from the plant itself, cycle by cycle, past encoders and drives.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from invid.config import CellConfig
from invid.errors import InvidError, SafetyStop
from invid.model.chains import CoupledChains
from invid.numerics.arrays import Float64, frozen_float
from invid.planning import AxisForecast, Plan, make_plan
from invid.planning.belief import Belief
from invid.planning.model import PlannedExperiment, Step
from invid.sweep import Sample, Sweep
from invid.sweep.ports import Wish
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.simulated import kernel, open_virtual_bus
from invid_drivers.simulated.cell import SimulatedCell


@dataclass(frozen=True, eq=False)
class Drawn:
    """A cell, the plant behind it, and the model that is known of it."""

    config: CellConfig
    model: Belief | None
    amplitude: float


def draw(seed: int) -> Drawn:
    """One healthy cell of one to six axes."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 7))
    cycle = float(rng.choice([0.002, 0.004]))
    amplitude = float(rng.choice([1.0, 1.0, 1.0, 0.1]))
    branches, axes, drives = [], [], {}
    ends, friction, viscous = [], [], []
    for i in range(count):
        name = f"A{i + 1}"
        masses, springs, dampers = _chain(rng)
        inertia = float(masses.sum())
        ends.append(masses[-1])
        limit = inertia * 10 ** rng.uniform(0.3, 1.2)
        rated = limit * rng.uniform(1.0, 2.0)
        branches.append({"axis": name, "masses": masses.tolist(), "springs": springs, "dampers": dampers})
        # The signs are tried at a tenth of the amplitude: that must be more than friction.
        friction.append(amplitude * limit * rng.choice([0.0, rng.uniform(0.0, 0.02)]))
        viscous.append(inertia * rng.uniform(0.0, 0.2))
        drives[name] = {
            "encoder_counts": float(2 ** rng.integers(17, 22)),
            "torque_noise": 0.005,
            "position_loop_Hz": float(rng.uniform(10, 30)),
            "friction": {"coulomb": friction[-1], "viscous": viscous[-1]},
        }
        axis: dict[str, Any] = {
            "name": name,
            "node_id": i + 1,
            "rated_torque_Nm": rated,
            "limits": {
                "torque_Nm": limit,
                "position_window_rad": float(10 ** rng.uniform(-1.2, -0.1)),
                "velocity_rad_per_s": float(rng.uniform(1.0, 6.0)),
            },
        }
        if rng.random() < 0.7:
            axis["inertia_kgm2"] = inertia * float(rng.uniform(0.8, 1.25))
        if rng.random() < 0.3:
            axis["hold"] = {"mode": "master_pd", "gain": inertia * (2 * np.pi * rng.uniform(2, 4)) ** 2}
        axes.append(axis)
    # an axis is shaken by no more than its own inertia
    couplings = [
        {
            "between": [f"A{i + 1}", f"A{j + 1}"],
            "value": float(rng.uniform(-0.6, 0.6) * min(ends[i], ends[j]) / max(count - 1, 1)),
        }
        for j in range(count)
        for i in range(j)
    ]
    document = {
        "format": "invid-config",
        "robot": f"drawn {seed}",
        "bus": {"interface": "invid-virtual", "channel": f"drawn-{seed}", "cycle_s": cycle, "max_load": 1.0},
        "axes": axes,
        "experiments": _experiments(rng, min(a["limits"]["position_window_rad"] for a in axes)),
        "simulation": {
            "seed": seed,
            "plant": {"branches": branches, "couplings": couplings},
            "axes": drives,
        },
    }
    config = CellConfig.model_validate(document)
    model = None
    if rng.random() < 0.5:
        model = _identified(rng, branches, couplings, friction, viscous)
    return Drawn(config, model, amplitude)


def by_default(drawn: Drawn) -> Drawn:
    """The cell with the default plan, of which nobody knows more than its config says."""
    return Drawn(drawn.config.model_copy(update={"experiments": []}), None, 1.0)


def _chain(rng: np.random.Generator) -> tuple[Float64, list[float], list[float]]:
    size = int(rng.integers(1, 4))
    masses = 10 ** rng.uniform(-1, 1.5) * rng.dirichlet(np.full(size, 8.0))
    pair = masses[:-1] * masses[1:] / (masses[:-1] + masses[1:])
    springs = pair * (2 * np.pi * rng.uniform(2.0, 5.0, size - 1)) ** 2
    dampers = 2 * 10 ** rng.uniform(-2.3, -1.3) * np.sqrt(springs * pair)
    return masses, springs.tolist(), dampers.tolist()


def _experiments(rng: np.random.Generator, window: float) -> list[dict[str, Any]]:
    low, high = float(rng.uniform(0.5, 1.0)), float(rng.uniform(8.0, 12.0))
    multisine = {"kind": "multisine", "band_Hz": [low, high], "seed": int(rng.integers(1000))}
    found = [
        {**multisine, "period_s": float(rng.uniform(4.0, 8.0)), "periods": 2, "lines": "all"},
        {**multisine, "period_s": 4.0, "periods": 2, "role": "validate", "amplitude": 0.35, "experiments": 1},
    ]
    others: list[dict[str, Any]] = [
        {"kind": "stepped_sine", "frequencies_Hz": [low, 3.0, 7.0], "cycles": 5, "axes": ["A1"]},
        {"kind": "chirp", "band_Hz": [low, high], "duration_s": 10.0, "axes": ["A1"]},
        {"kind": "constant_velocity", "velocities": [window / 2], "travel": window, "axes": ["A1"]},
    ]
    if rng.random() < 0.5:
        found.append(others[int(rng.integers(3))])
    return found


def _identified(
    rng: np.random.Generator,
    branches: Sequence[dict[str, Any]],
    couplings: Sequence[dict[str, Any]],
    friction: Sequence[float],
    viscous: Sequence[float],
) -> Belief:
    """The plant as an identification returns it: a per cent off, and a tenth in what damps."""
    count = len(branches)

    def about(values: Sequence[float], share: float) -> Float64:
        return np.array(values) * (1 + share * rng.standard_normal(len(values)))

    matrix = np.zeros((count, count))
    for c in couplings:
        i, j = (int(n[1:]) - 1 for n in c["between"])
        matrix[i, j] = matrix[j, i] = c["value"]
    chains = CoupledChains.build(
        [about(b["masses"], 0.01) for b in branches],
        [about(b["springs"], 0.01) for b in branches],
        [about(b["dampers"], 0.1) for b in branches],
        matrix,
        axes=[b["axis"] for b in branches],
    )
    return Belief(
        chains, frozen_float(about(viscous, 0.1)), frozen_float(about(friction, 0.1)), "drawn", False
    )


@dataclass
class Truth:
    """What the plant did: peaks (3, M) of travel, velocity and torque by phase; ``left`` by the limits of the
    config on the way out, where drives stop by themselves."""

    plan: Plan
    peaks: dict[str, Float64] = field(default_factory=dict)
    left: Float64 = field(default_factory=lambda: np.zeros(0))
    clipped: int = 0
    seconds: float = 0.0
    error: str | None = None
    after: tuple[AxisForecast, ...] = ()
    scale: float = 1.0
    shares: list[float] = field(default_factory=list)
    """Of its amplitude, of each experiment that was recorded."""
    warnings: tuple[str, ...] = ()

    def ratios(self) -> Float64:
        """(phases, 3, M) measured over announced: by the plan until the trials, then by them."""
        told = _bounds(self.plan.forecast)
        later = _bounds(self.after) if self.after else told
        return np.array(
            [p / (later if name.startswith("experiment") else told) for name, p in self.peaks.items()]
        )

    def generosity(self) -> Float64:
        """(3, M) announced after the trials over the largest that was measured."""
        most = np.max(list(self.peaks.values()), axis=0)
        return _bounds(self.after or self.plan.forecast) / np.maximum(most, 1e-9)


def _bounds(forecast: Sequence[AxisForecast]) -> Float64:
    return np.array([[f.travel, f.velocity, f.peak_torque] for f in forecast]).T


class _Sink:
    def __init__(self) -> None:
        self.shares: list[float] = []

    def begin(self, experiment: PlannedExperiment, hold_gain: Sequence[float], scale: float) -> None:
        self.shares.append(scale)

    def row(self, sample: Sample, demand: Sequence[float]) -> None: ...

    def end(self) -> None: ...


def run(drawn: Drawn, until: str = "") -> Truth:
    """The run in virtual time, whole or up to a phase; the truth of every cycle."""
    config = drawn.config
    plan = make_plan(config, amplitude_scale=drawn.amplitude, model=drawn.model)
    names = [p.name for p in plan.phases]
    if until:
        plan = replace(plan, phases=plan.phases[: names.index(until) + 1])
    truth = Truth(plan)
    cells: list[SimulatedCell] = []
    cell = Cia402Cell(open_virtual_bus(config, prepare=cells.append), config)
    plant = cells[0].plant
    motors = plant.structure.motors
    limits = np.array([a.limits.torque for a in config.axes])
    bounds = np.array([[a.limits.position, a.limits.velocity, a.limits.torque] for a in config.axes]).T
    tick, origin = cell.tick, plant.positions[motors].copy()

    def watched(wish: Wish) -> Sample:
        sample = tick(wish)
        seen = np.abs(
            [
                plant.positions[motors] - origin,
                plant.velocities[motors],
                plant.motor_state[:, kernel.ACTING],
            ]
        )
        if cell._supervised.is_leaving:
            truth.left = np.maximum(truth.left, seen / bounds) if truth.left.size else seen / bounds
            return sample
        phase = sweep._motion.phase
        truth.peaks[phase] = np.maximum(truth.peaks.get(phase, 0.0), seen)
        if wish.torque:
            truth.clipped += int((np.abs(wish.torque) >= limits * (1 - 1e-9)).sum())
        return sample

    cell.tick = watched  # type: ignore[method-assign]
    sink = _Sink()
    truth.shares = sink.shares
    sweep = Sweep(plan, config, cell, sink)
    try:
        cell.check()
        result = sweep.run()
        truth.seconds, truth.after, truth.scale = result.measured_s, result.forecast, result.scale
        truth.warnings = result.warnings
    except InvidError as error:
        truth.error = f"{sweep._motion.phase}: {error}"
        truth.after, truth.scale = sweep._rehearsal.forecast(), float(sweep._rehearsal.scales.min())
    finally:
        cell.close()
    return truth


def try_signs(drawn: Drawn) -> SafetyStop | None:
    """Only the trials of the signs; what stopped them."""
    plan = make_plan(drawn.config, amplitude_scale=drawn.amplitude, model=drawn.model)
    phases = tuple(p for p in plan.phases if p.step in (Step.SETTLE, Step.SIGNS))
    cell = Cia402Cell(open_virtual_bus(drawn.config), drawn.config)
    try:
        cell.check()
        Sweep(replace(plan, phases=phases), drawn.config, cell, _Sink()).run()
    except SafetyStop as error:
        return error
    finally:
        cell.close()
    return None
