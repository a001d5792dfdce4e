"""What a campaign judges on: the true motion and torque of the plant, what was written, who was disturbed.

Nothing here asks the master. Each rule is a method of ``Judge`` that returns complaints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from invid.config import CellConfig
from invid_drivers.simulated import kernel
from invid_drivers.simulated.cell import SimulatedCell
from invid_drivers.simulated.config import simulation_of
from invid_drivers.simulated.object_dictionary import Entry, ObjectDictionary
from invid_drivers.simulated.state_machine import State

Floats = NDArray[np.float64]

TORQUE_MARGIN = 1.05
"""True torque against the tightest limit: 5 %, for steps of 0x6071 and of the current loop."""
LOADED_TRAVEL = 0.02
"""How far a loaded axis may be from where it stopped until the user acts [rad]."""
RAMP = 10.0
"""Deceleration that the campaign's drives have unless a run says otherwise [rad/s²]."""
SHAKE_CYCLES = 3
"""Cycles beyond ``missed_tpdos`` from what happens to the drive's reaction."""
WATCH_BEATS = 3.0
"""Heartbeats that a drive does without before it stops by itself."""
COAST_S = 3.0
"""What an axis without torque and brake does later is its coupled neighbours' doing [s]."""
SETTLE = 1e-3
"""What springs and quantisation add to a stop [rad]."""

SAFE = {
    State.SWITCH_ON_DISABLED,
    State.READY_TO_SWITCH_ON,
    State.SWITCHED_ON,
    State.FAULT,
    State.NOT_READY_TO_SWITCH_ON,
}
"""States without torque. A loaded axis may be held in quick stop active instead."""

_NO_LIMIT = 0xFFFFFFFF
UPPER = (
    (0x6072, 0),
    (0x6073, 0),
    (0x607D, 2),
    (0x607F, 0),
    (0x6080, 0),
    (0x6065, 0),
    (0x6066, 0),
    (0x3001, 2),
)
"""Objects that permit more the larger they are."""
LOWER = ((0x607D, 1),)
"""Objects that permit more the smaller they are."""


class Watch:
    """The plant, seen at every sample of its drives, past encoders and bus."""

    def __init__(self, cell: SimulatedCell) -> None:
        self._cell = cell
        plant = cell.plant
        self._motors = plant.structure.motors
        self._velocities = self._motors + plant.state.size // 2
        count = self._motors.size
        self._rows = np.zeros((4096, 4 * count + 1))
        self._count = 0
        observe = plant.observe

        def seen(now_ns: int, noise: Any) -> Any:
            values = observe(now_ns, noise)
            self._take(now_ns)
            return values

        plant.observe = seen  # type: ignore[method-assign]
        self.begin()

    def begin(self) -> None:
        """Forget the extremes; where every motor is now is where it starts."""
        self._count = 0
        self._powered = np.full(self._motors.size, -np.inf)
        self._origin = self._mark = self.positions
        self._drift = np.zeros(self._motors.size)
        self._travel = np.zeros(self._motors.size)
        self._speed = np.zeros(self._motors.size)
        self._commanded = np.zeros(self._motors.size)
        self._by_loop = np.zeros(self._motors.size)

    def mark(self) -> None:
        """Drift counts from here."""
        self._reduce()
        self._mark = self.positions
        self._drift = np.zeros(self._motors.size)

    @property
    def positions(self) -> Floats:
        """Where the motors are [rad]."""
        self._cell.plant.advance_to(self._cell.now_ns)
        return np.array(self._cell.plant.state[self._motors])

    @property
    def velocities(self) -> Floats:
        """How fast the motors are [rad/s]."""
        return np.array(self._cell.plant.state[self._velocities])

    def _take(self, now_ns: int) -> None:
        plant, n = self._cell.plant, self._motors.size
        row = self._rows[self._count]
        row[:n] = plant.state[self._motors]
        row[n : 2 * n] = plant.state[self._velocities]
        row[2 * n : 3 * n] = plant.motor_state[:, kernel.ACTING]
        row[3 * n : -1] = plant.command[:, kernel.MODE]
        row[-1] = now_ns * 1e-9
        self._count += 1
        if self._count == len(self._rows):
            self._reduce()

    def _reduce(self) -> None:
        rows, n = self._rows[: self._count], self._motors.size
        if not self._count:
            return
        now = rows[:, -1:]
        last = np.where(rows[:, 3 * n : -1] != kernel.MODE_OFF, now, -np.inf)
        last = np.maximum.accumulate(np.maximum(last, self._powered), axis=0)
        self._powered = last[-1]
        counts = (now - last <= COAST_S) | np.isneginf(last)
        away = np.where(counts, np.abs(rows[:, :n] - self._origin), 0.0)
        np.maximum(self._travel, away.max(axis=0), out=self._travel)
        np.maximum(self._drift, np.abs(rows[:, :n] - self._mark).max(axis=0), out=self._drift)
        np.maximum(self._speed, np.abs(rows[:, n : 2 * n]).max(axis=0), out=self._speed)
        torque, mode = np.abs(rows[:, 2 * n : 3 * n]), rows[:, 3 * n : -1]
        # the row in which the mode changes may still bear the torque of the mode before
        before = np.vstack([mode[:1], mode[:-1]])
        own = (mode == kernel.MODE_TORQUE) & (before == kernel.MODE_TORQUE)
        loop = (mode == kernel.MODE_POSITION) & (before == kernel.MODE_POSITION)
        np.maximum(self._commanded, np.where(own, torque, 0.0).max(axis=0), out=self._commanded)
        np.maximum(self._by_loop, np.where(loop, torque, 0.0).max(axis=0), out=self._by_loop)
        self._count = 0

    @property
    def travel(self) -> Floats:
        """Largest distance of each motor from where it started [rad]."""
        self._reduce()
        return self._travel

    @property
    def drift(self) -> Floats:
        """Largest distance of each motor from where it was at the mark [rad]."""
        self._reduce()
        return self._drift

    @property
    def speed(self) -> Floats:
        """Largest speed of each motor [rad/s]."""
        self._reduce()
        return self._speed

    @property
    def commanded(self) -> Floats:
        """Largest torque that acted in torque mode [N·m]."""
        self._reduce()
        return self._commanded

    @property
    def by_loop(self) -> Floats:
        """Largest torque that the drives' own position loops and ramps made [N·m]."""
        self._reduce()
        return self._by_loop


@dataclass(frozen=True)
class Found:
    """One drive's settings before anybody wrote."""

    values: dict[tuple[int, int], int]
    writable: frozenset[tuple[int, int]]

    @classmethod
    def of(cls, od: ObjectDictionary) -> Found:
        """Every numeric object that may be set."""
        numbers = [e for e in od if not isinstance(e.value, str)]
        return cls(
            {(e.index, e.sub): int(e.value) for e in numbers},
            frozenset((e.index, e.sub) for e in numbers if e.access == "rw"),
        )


class Judge:
    """The rules for one cell; made before the first command."""

    def __init__(self, config: CellConfig, cell: SimulatedCell) -> None:
        self.config, self.cell = config, cell
        self.watch = Watch(cell)
        self.found = [Found.of(d.node.od) for d in cell.drives]
        self._settings = [simulation_of(config).axis(a.name) for a in config.axes]
        self.blind: set[int] = set()
        """Rows of axes whose encoders died while their drives held them."""
        self._nmt: set[tuple[int, int]] = set()
        self._written_to: dict[int, int] = {}
        self._note_blindness()
        self._listen()

    def _note_blindness(self) -> None:
        begin = self.cell._injector.begin

        def noted(fault: Any, now_ns: int) -> None:
            if fault.kind == "encoder_stuck":
                drive = self.cell.drive(fault.axis)
                if self.cell.plant.command[drive.row, kernel.MODE] == kernel.MODE_POSITION:
                    self.blind.add(drive.row)
            begin(fault, now_ns)

        self.cell._injector.begin = noted  # type: ignore[method-assign]

    # --- limits --------------------------------------------------------------------------------
    def torque_limits(self) -> tuple[Floats, Floats]:
        """The tightest limit for commanded torque, and for the drives' own loops [N·m]."""
        commanded, by_loop = [], []
        for axis, drive, found in zip(self.config.axes, self.cell.drives, self.found, strict=True):
            permille = found.values.get((0x6072, 0))
            own = np.inf if permille is None else permille * drive.rated_torque / 1000.0
            commanded.append(min(axis.limits.torque, own))
            # nobody can limit the loop of a drive whose limit is missing or read-only
            by_loop.append(commanded[-1] if (0x6072, 0) in found.writable else own)
        return np.array(commanded), np.array(by_loop)

    def torque(self) -> list[str]:
        """True torque within 5 % of the tightest of config and what the drive was commissioned with."""
        complaints = []
        for what, seen, limits in zip(
            ("in torque mode", "by its drive"),
            (self.watch.commanded, self.watch.by_loop),
            self.torque_limits(),
            strict=True,
        ):
            for axis, value, limit in zip(self.config.axes, seen, limits, strict=True):
                if value > TORQUE_MARGIN * limit:
                    complaints.append(f"{axis.name}: {value:.3g} N·m {what}, limit {limit:.3g}")
        return complaints

    def window(self) -> Floats:
        """The tighter of the config's window and the drive's position limits around the start [rad]."""
        windows = []
        for axis, drive, found in zip(self.config.axes, self.cell.drives, self.found, strict=True):
            low, high = found.values.get((0x607D, 1), 0), found.values.get((0x607D, 2), 0)
            own = min(high, -low) / drive.counts_per_unit if low < high else np.inf
            windows.append(min(axis.limits.position, own))
        return np.array(windows)

    def budget(self, *, dead_master: bool, late_cut: float = 0.0) -> Floats:
        """What an axis may go beyond its window: the reaction, the stop, at most at the permitted
        speed [rad].

        The stop is by the drive's ramp, or by what the torque limit leaves beside the load.
        ``late_cut``: longer before an axis is cut off [s].
        """
        safety, cycle = self.config.safety, self.config.bus.cycle_s
        most = np.array([a.limits.velocity for a in self.config.axes])
        inertia = np.array([a.inertia or np.nan for a in self.config.axes])
        load = np.array([abs(s.load.torque) for s in self._settings])
        speed = np.minimum(self.watch.speed, TORQUE_MARGIN * most)
        can = np.maximum((self.torque_limits()[0] - load) / inertia, 0.1)
        deceleration = np.fmin(RAMP, can)
        reaction = (safety.missed_tpdos + SHAKE_CYCLES) * cycle + late_cut
        if dead_master:
            reaction += WATCH_BEATS * safety.heartbeat_s
        result: Floats = speed * reaction + speed**2 / (2.0 * deceleration) + SETTLE
        return result

    def excess(self, *, dead_master: bool = False, late_cut: float = 0.0) -> Floats:
        """Way beyond the window as a share of the budget; at most 1 is good."""
        beyond = self.watch.travel - self.window()
        result: Floats = beyond / self.budget(dead_master=dead_master, late_cut=late_cut)
        return result

    def travel(self, *, dead_master: bool = False, late_cut: float = 0.0) -> list[str]:
        """No axis further than its window and its budget, but one that is blind."""
        excess = self.excess(dead_master=dead_master, late_cut=late_cut)
        return [
            f"{axis.name}: {travel:.3g} rad, window {window:.3g}, {share:.2f} budgets beyond"
            for i, (axis, travel, window, share) in enumerate(
                zip(self.config.axes, self.watch.travel, self.window(), excess, strict=True)
            )
            if share > 1.0 and i not in self.blind
        ]

    # --- loads ---------------------------------------------------------------------------------
    def stopped(self) -> None:
        """A command has ended: from here on nothing may move that is loaded."""
        self.watch.mark()

    def loads(self) -> list[str]:
        """Loaded axes within 0.02 rad of where they stopped, all the time since ``stopped``."""
        return [
            f"{axis.name}: loaded, moved {travel:.3g} rad after it had stopped"
            for i, (axis, settings, travel) in enumerate(
                zip(self.config.axes, self._settings, self.watch.drift, strict=True)
            )
            if settings.load.torque and travel > LOADED_TRAVEL and i not in self.blind
        ]

    # --- states and settings -------------------------------------------------------------------
    def states(self) -> list[str]:
        """Every drive without torque, or a loaded one held by its quick stop."""
        return [
            f"{axis.name} ended in {drive.state.name}"
            for axis, drive, settings in zip(self.config.axes, self.cell.drives, self._settings, strict=True)
            if drive.state not in SAFE
            and not (settings.load.torque and drive.state is State.QUICK_STOP_ACTIVE)
        ]

    def readiness(self, status: int) -> list[str]:
        """What is under power is not called ready, and stays as it is."""
        energised = [
            a.name for a, d in zip(self.config.axes, self.cell.drives, strict=True) if d.state not in SAFE
        ]
        return (
            [f"check calls the cell ready with {', '.join(energised)} energised"]
            if energised and not status
            else []
        )

    def foreign(self, *, other_master: bool = False) -> list[str]:
        """The master's NMT and writes go to configured nodes only, and others stay as they were found.

        ``other_master``: somebody else sends NMT commands too, so that states say nothing of ours.
        """
        ours = {a.node_id for a in self.config.axes}
        complaints = [
            f"NMT command {command} to {node or 'every node'}"
            for command, node in sorted(self._nmt)
            if node not in ours
        ]
        complaints += [f"{count} writes to foreign node {node}" for node, count in self._written_to.items()]
        complaints += [
            f"foreign node {node.node_id} was set {', '.join(s.name for s in node.nmt_changes)}"
            for node in self.cell.foreign
            if node.nmt_changes and not other_master
        ]
        return complaints

    def _listen(self) -> None:
        """What the master sends that is for others' ears."""
        receive = self.cell.receive
        ids = {0x600 + n.node_id: n.node_id for n in self.cell.foreign}

        def heard(can_id: int, data: bytes, now_ns: int) -> None:
            if can_id == 0 and len(data) == 2:
                self._nmt.add((data[0], data[1]))
            elif can_id in ids and data[:1] and data[0] >> 5 == 1:
                self._written_to[ids[can_id]] = self._written_to.get(ids[can_id], 0) + 1
            receive(can_id, data, now_ns)

        self.cell.receive = heard  # type: ignore[method-assign]

    def settings(self, written: Sequence[tuple[int, int, int, int]]) -> list[str]:
        """No write permits more than was found."""
        complaints = []
        for row, index, sub, value in written:
            was = self.found[row].values[index, sub]
            low, high = (self.found[row].values.get((0x607D, s), 0) for s in (1, 2))
            unwatched = self.found[row].values.get((0x6065, 0), _NO_LIMIT) == _NO_LIMIT
            if value == was or (index == 0x607D and low >= high) or (index == 0x6066 and unwatched):
                continue  # nothing was limited, so whatever is written is tighter
            wider = (
                value > was
                if (index, sub) in UPPER
                else value < was
                if (index, sub) in LOWER
                else index == 0x1016 and bool(was & 0xFFFF) and not 0 < value & 0xFFFF <= was & 0xFFFF
            )
            if wider:
                name = self.config.axes[row].name
                complaints.append(f"{name}: 0x{index:04X}:{sub} widened from {was} to {value}")
        return complaints


@contextmanager
def writes(cell: SimulatedCell) -> Iterator[list[tuple[int, int, int, int]]]:
    """(row of the drive, index, sub, value) of every accepted SDO download, as it comes."""
    rows = {id(e): i for i, d in enumerate(cell.drives) for e in d.node.od}
    seen: list[tuple[int, int, int, int]] = []
    original: Callable[[Entry, bytes], None] = Entry.write

    def write(self: Entry, data: bytes) -> None:
        original(self, data)
        row = rows.get(id(self))
        if row is not None and not isinstance(self.value, str):
            seen.append((row, self.index, self.sub, int(self.value)))

    Entry.write = write  # type: ignore[method-assign]
    try:
        yield seen
    finally:
        Entry.write = original  # type: ignore[method-assign]
