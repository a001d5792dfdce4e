"""A cell and what happens to it, as a kind draws it; and the phases of an ordinary run."""

import random
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .axis import STATES
from .cell import Run

PHASES = ("enabling", "rest", "trial", "run", "hold", "leaving")
"""Powering up; enabled and still, stop test; first motions; what is recorded; standing while another is moved
or between experiments; from the end of what is recorded."""
ALWAYS = "always"
WINDOW, ROOM, SPEED = 0.5, 0.5, 5.0
"""Of every axis: window, stated room beyond it [rad], permitted speed [rad/s]."""
ENABLED = STATES.index("enabled")


@dataclass
class DraftAxis:
    """One axis of a draft."""

    load: float = 0.0
    brake: float | None = None
    stated: bool | None = None
    """Whether the config says that it carries something; ``None``: it says nothing."""
    torque_limit: float = 20.0
    inertia: float = 1.0
    plant: dict[str, Any] = field(default_factory=dict)
    habits: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    config: dict[str, Any] = field(default_factory=dict)
    falls: float = 0.0
    """What physics lets it fall by, beyond what is demanded of every axis [rad]."""
    told: str = ""
    """What must have been said of that, as a pattern."""
    tightest: float | None = None
    """Torque limit that the drive was found with, where that is tighter [N·m]."""

    def habit(self, name: str, **keys: Any) -> None:
        """Add one."""
        self.habits.append((name, keys))

    @property
    def by_brake(self) -> float:
        """How far it falls from rest until its brake has closed [rad]."""
        return 0.5 * self.load / self.inertia * (self.brake or 0.0) ** 2

    def falls_until_braked(self, after: float = 0.0) -> None:
        """It falls until its brake has closed, ``after`` [s] what happens; for good without one."""
        if self.load:
            seconds = after + (self.brake or 0.0)
            fall = 0.5 * self.load / self.inertia * seconds**2 + 0.6 * seconds
            self.falls = max(self.falls, fall if self.brake is not None else np.inf)


@dataclass
class Draft:
    """One run, before it is one."""

    kind: str
    phase: str
    loads: int
    seed: int
    axes: list[DraftAxis]
    rng: random.Random
    at: float = np.inf
    """When it happens [s]."""
    victims: list[DraftAxis] = field(default_factory=list)
    """Whom it happens to."""
    events: list[dict[str, Any]] = field(default_factory=list)
    """Of the first command."""
    later: list[tuple[str, list[dict[str, Any]]]] = field(default_factory=list)
    """Further commands on the same cell, and what happens during each."""
    nodes: dict[str, Any] = field(default_factory=dict)
    """Keys of every victim's node."""
    found: dict[int, int] = field(default_factory=dict)
    """Objects that the victims' drives were found with."""
    lacks: list[int] = field(default_factory=list)
    """Indices or addresses that they do not have."""
    safety: dict[str, Any] = field(default_factory=dict)
    experiment: dict[str, Any] = field(default_factory=dict)
    healthy: bool = False
    """To be measured."""
    must_stop: bool = False
    """May not end as if nothing had been."""
    never_again: bool = False
    """Once off by this, nothing may enable it before a person acts."""
    travels: float = 0.0
    """What physics lets an axis without load travel beyond window and room [rad]."""
    pair: bool = False
    """The first two axes are one node's."""

    def spec(self) -> dict[str, Any]:
        """What is behind the wire."""
        nodes: list[dict[str, Any]] = []
        for k, axis in enumerate(self.axes):
            plant = {"load": axis.load, "inertia": axis.inertia, "brake": axis.brake, **axis.plant}
            if axis.load and axis.brake is None:
                plant.setdefault("propped", True)
            habits = [*axis.habits]
            if not any(name == "TorqueShown" for name, _ in habits):
                habits.append(("TorqueShown", {"seed": self.seed + k}))
            if self.pair and k == 1:
                nodes[0]["axes"].append({"plant": plant, "habits": habits})
                continue
            node: dict[str, Any] = {"node": k + 1, "axes": [{"plant": plant, "habits": habits}]}
            if axis in self.victims:
                node |= self.nodes
                node["found"] = {f"{at:06X}": v for at, v in self.found.items()}
                node["lacks"] = [f"{i:04X}" for i in self.lacks]
            nodes.append(node)
        return {"nodes": [*nodes, {"node": 9, "own": False, "axes": []}]}

    def config(self) -> dict[str, Any]:
        """What its user says of it."""
        axes = []
        for k, axis in enumerate(self.axes):
            said: dict[str, Any] = {
                "name": f"A{k + 1}", "node_id": 1 if self.pair and k == 1 else k + 1,
                "inertia_kgm2": axis.inertia,
                "limits": {"torque_Nm": axis.torque_limit, "position_window_rad": WINDOW,
                           "velocity_rad_per_s": SPEED, "stopping_room_rad": ROOM},
            }  # fmt: skip
            if self.pair and k == 1:
                said["axis_of_node"] = 2
            if axis.stated is not None:
                said["gravity_loaded"] = axis.stated
            if axis.brake is not None:
                said["brake"] = "drive"
            axes.append({**said, **axis.config})
        experiment = {"kind": "multisine", "amplitude": 0.2, "band_Hz": [2, 20], "period_s": 1, "periods": 2}
        return {"axes": axes, "safety": self.safety, "experiments": [{**experiment, **self.experiment}]}

    @property
    def cell_key(self) -> tuple[Any, ...]:
        """What an ordinary run of the same machine depends on."""
        return tuple((a.load, a.brake, a.stated, a.inertia) for a in self.axes)


def draw_cell(kind: str, phase: str, loads: int, seed: int, *, brakes: bool | None = None) -> Draft:
    """An ordinary cell with so many loads; ``brakes``: all of them, none, or as it is drawn."""
    rng = random.Random(f"{kind}/{phase}/{loads}/{seed}")
    # few cells, so that an ordinary run of each is known soon
    cell = random.Random(f"{loads}/{brakes}/{seed % 2}")
    axes = [
        DraftAxis(
            load=cell.choice([5.0, 8.0]),
            brake=0.05 if brakes or (brakes is None and cell.random() < 0.5) else None,
            stated=cell.choice([True, None]),
        )
        for _ in range(loads)
    ]
    if loads == 0:
        axes = [DraftAxis(stated=False) for _ in range(1 + seed % 2)]
    elif loads < 3 and seed % 2:
        axes.insert(cell.randrange(loads + 1), DraftAxis(stated=False))
    return Draft(kind, phase, loads, seed, axes, rng)


@dataclass(frozen=True)
class Timeline:
    """When an ordinary run is in which phase."""

    phases: dict[str, list[tuple[float, float]]]
    holds: list[list[tuple[float, float]]]
    """For each axis."""
    played: list[float]
    """How far each axis was from its start, at most [rad]."""
    status: int | None

    def draw(self, phase: str, axis: int, rng: random.Random) -> float | None:
        """An instant of a phase; ``None`` where the run has none."""
        spans = self.holds[axis] if phase == "hold" else self.phases.get(phase, [])
        spans = [(a, b) for a, b in spans if b > a]
        if not spans:
            return None
        low, high = rng.choices(spans, [b - a for a, b in spans])[0]
        return rng.uniform(low, high)


def read_timeline(run: Run, axes: int, recorded: list[tuple[float, float]]) -> Timeline:
    """The phases of an ordinary run, from the plant's motion and what was recorded when."""
    over = run.when("over") or 0.0
    rows = [run.of(k) for k in range(axes)]
    on = [r["t"][r["state"] == ENABLED] for r in rows]
    moved = [np.abs(r["q"] - r["q"][0]) for r in rows]
    played = [float(m[r["t"] < over].max(initial=0.0)) for r, m in zip(rows, moved, strict=True)]
    if not all(len(o) for o in on) or not recorded:
        return Timeline({}, [[] for _ in rows], played, run.status)
    began = min(e.t for e in run.events if e.text.startswith("off to ready"))
    enabled = max(float(o[0]) for o in on)
    first = min(_first_motion(r, enabled + 0.3) for r in rows)
    start, end = recorded[0][0], recorded[-1][1]
    left = min(float(o[o > end - 0.1].max(initial=end)) for o in on)
    phases = {
        "enabling": [(began, enabled + 0.2)],
        "rest": [(enabled + 0.2, first)],
        "trial": [(first, start)],
        "run": recorded,
        "leaving": [(end, max(left, over - 0.02))],
    }
    return Timeline(phases, [_stands(r, first, end) for r in rows], played, run.status)


def _first_motion(rows: Any, after: float) -> float:
    """When an axis begins to be shaken: while enabled, faster than a settling hold."""
    moving = (rows["t"] > after) & (rows["state"] == ENABLED) & (np.abs(rows["v"]) > 0.02)
    return float(rows["t"][moving][0]) if moving.any() else np.inf


def _stands(rows: Any, first: float, end: float) -> list[tuple[float, float]]:
    """Spans longer than 0.3 s in which an axis stands though the cell is in motion."""
    inside = rows[(rows["t"] > first) & (rows["t"] < end)]
    still = np.abs(inside["v"]) < 0.004
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    spans = [(float(inside["t"][a]), float(inside["t"][b - 1])) for a, b in edges.reshape(-1, 2)]
    return [(a + 0.1, b - 0.1) for a, b in spans if b - a > 0.3]
