"""The simulated cell: drives, plant and faults, without a bus and without a clock.

A bus adapter feeds frames and time in and takes frames out; the same cell stands behind the bus in
virtual time and behind ``invid simcell`` in real time. Times are integer nanoseconds since the start.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from invid.config.schema import AxisConfig, CellConfig
from invid.effects.elements import ReadingError, RepeatedRows, TorqueChannel
from invid.errors import ConfigError
from invid.numerics.arrays import Float64
from invid_drivers.simulated import kernel
from invid_drivers.simulated.brake import Brake
from invid_drivers.simulated.config import AxisSimulation, LoopValues, simulation_of, truth
from invid_drivers.simulated.drive import Drive, Scales
from invid_drivers.simulated.eds import apply_eds
from invid_drivers.simulated.faults import FaultInjector, disturb
from invid_drivers.simulated.node import Handler, Node
from invid_drivers.simulated.object_dictionary import Nameplate, drive_dictionary
from invid_drivers.simulated.plant import Plant
from invid_drivers.simulated.structure import build_structure
from invid_drivers.simulated.vendors import PROFILES

NEVER = 1 << 62
_NS = 1_000_000_000
_TICK_NS = 1_000_000  # the drives' own control period where no SYNC drives them
_NOISE_ROWS = 4096
_MOST_SUBSTEPS = 500
"""Sub-steps a cycle; at about a microsecond each, more would be slower than real time."""

SAMPLED_S = 0.001
"""Cycle of loops that a config states, unless it says another: that of `invid tune`."""

Emit = Callable[[int, bytes], None]


class SimulatedCell:
    """All drives of a cell on one plant.

    Parameters
    ----------
    config
        A cell with a ``simulation`` section.
    """

    def __init__(self, config: CellConfig) -> None:
        self.config = config
        self.simulation = simulation_of(config)
        self.now_ns = 0
        self.due_ns = NEVER
        self.transmit: Emit = lambda can_id, data: None
        """Set by the bus: (identifier, data)."""
        self.master_off = False
        """True while the master's own port is bus-off."""
        self._timers: list[tuple[int, int, Callable[[int], None]]] = []
        self._count = 0
        self._dispatch: dict[int, list[Handler]] | None = None
        self._tick_ns = 0
        self.injector = FaultInjector(self)
        self.frame_faults = self.injector.frames
        self.frames_in = self.frames_out = self.syncs = 0
        chains = truth(config)
        axes = [self.simulation.axis(a.name) for a in config.axes]
        structure = build_structure(chains, axes, self.simulation.effects)
        cycle = config.bus.cycle_s
        # friction and brakes are solved within a sub-step: it must not span more than a radian of the
        # fastest mode, or a push could leave a mass moving the other way
        fastest = float(structure.still.natural[-1])
        longest = min(self.simulation.plant.substep_s, 1.0 / max(fastest, 1e-9))
        substeps = math.ceil(cycle / longest - 1e-9)
        if substeps > _MOST_SUBSTEPS:
            raise ConfigError(
                f"config of {config.robot!r}: simulation.plant has a mode at "
                f"{fastest / (2.0 * math.pi):.3g} Hz, which needs {substeps} sub-steps "
                f"a cycle; at most {_MOST_SUBSTEPS} are allowed: take softer springs or heavier masses"
            )
        self.plant = Plant(structure, cycle / substeps)
        streams = np.random.SeedSequence(self.simulation.seed).spawn(3)
        self._noise_random, self._fault_random, self._drop_random = map(np.random.default_rng, streams)
        self.drives: list[Drive] = []
        for i, (axis, settings) in enumerate(zip(config.axes, axes, strict=True)):
            self.drives.append(self._build_drive(i, axis, settings, float(chains.masses[i][0])))
        self._drop_rate = np.zeros(len(axes))
        self._set_motor_effects()
        self._drops = bool(self._drop_rate.any())
        self._noise_scale = np.array(
            [(a.position_noise_counts, a.torque_noise * 1000.0) for a in axes], dtype=float
        )
        self._noise = np.zeros((_NOISE_ROWS, len(axes), 2))
        self._noise_row = _NOISE_ROWS
        self._noisy = bool(self._noise_scale.any())
        for fault in self.simulation.faults:
            self.injector.plan(fault)
        self._load(axes)
        for drive in self.drives:
            drive.node.power_on(0)
        self.schedule(_TICK_NS, self._watchdog)

    def _build_drive(self, row: int, axis: AxisConfig, settings: AxisSimulation, motor: float) -> Drive:
        linear = self.config.motion == "linear"
        objects = settings.objects
        known = PROFILES[objects.profile]
        profile = replace(
            known,
            lacks=known.lacks | {int(name, 0) for name in objects.lacks},
            values={**known.values, **{_address(k): v for k, v in objects.values.items()}},
        )
        rated = settings.rated_torque or axis.rated_torque or 100.0
        counts_per_unit = settings.encoder_counts / (1.0 if linear else 2.0 * math.pi)
        # 0x6085 counts motor revolutions per minute and second with some drives
        ramp_counts = 1.0 if settings.ramp_unit == "counts_per_s2" else settings.encoder_counts / 60.0
        ramps = [
            max(1, round(a * counts_per_unit / ramp_counts)) for a in (2.0, settings.quick_stop_deceleration)
        ]
        plate = Nameplate("invid drive", axis.node_id, rated, settings.encoder_counts)
        od = drive_dictionary(axis.node_id, plate, profile, (ramps[0], ramps[1]))
        if objects.eds is not None:
            apply_eds(od, Path(objects.eds), axis.node_id)
        for name in objects.read_only:
            entry = od.find(*_address(name))
            if entry is not None:
                entry.access = "ro"
        node = Node(
            axis.node_id,
            od,
            self,
            sdo_ns=round(settings.sdo_response_s * _NS),
            boot_ns=round(self.simulation.boot_s * _NS),
        )
        load = abs(settings.load.torque)
        brake = Brake(
            self.plant.command[row],
            self._after,
            torque=(settings.brake_torque or 2.0 * rated) if settings.brake else 0.0,
            delay_ns=round(settings.brake_delay_s * _NS),
            prop=2.0 * load if settings.load.propped else 0.0,
        )
        drive = Drive(
            row,
            node,
            self.plant,
            brake,
            Scales(
                rated,
                counts_per_unit,
                axis.direction,
                linear,
                known.velocity_in_rpm,
                cycle_s=self.config.bus.cycle_s,
                ramp_counts=ramp_counts,
                own_ramp=ramps[1],
            ),
            settings,
        )
        node.application = drive
        command = self.plant.command[row]
        command[kernel.RATED] = rated
        command[kernel.DIRECTION] = axis.direction
        command[kernel.COUNTS_PER_UNIT] = counts_per_unit
        command[kernel.TORQUE_STEPS] = settings.torque_steps_permille
        command[kernel.LAG] = _lag(self.plant.h, settings.current_loop_s)
        # 0.7 of critical damping on the motor mass alone; passive, so stable on any structure
        bandwidth = 2.0 * math.pi * settings.position_loop_Hz
        own = LoopValues(velocity_gain=1.4 * motor * bandwidth, position_gain=bandwidth / 1.4)
        stated = settings.loops
        _put_loops(command, stated or own, settings.loop_cycle_s or (SAMPLED_S if stated else 0.0))
        return drive

    def _load(self, axes: list[AxisSimulation]) -> None:
        """Put the loads on, with every spring stretched as it is at rest behind a motor that stands."""
        structure, external = self.plant.structure, self.plant.external
        for motor, settings, count in zip(
            structure.motors, axes, structure.chains.masses_per_branch, strict=True
        ):
            last = settings.load.element == "last mass"
            external[int(motor) + (count - 1 if last else 0)] -= settings.load.torque
        inner = np.setdiff1d(np.arange(structure.dofs), structure.motors)
        if inner.size and external.any():
            stiffness = structure.still.stiffness[np.ix_(inner, inner)]
            self.plant.state[inner] = np.linalg.lstsq(stiffness, external[inner], rcond=None)[0]

    def _after(self, delay_ns: int, callback: Callable[[int], None]) -> None:
        def due(now_ns: int) -> None:
            self.plant.advance_to(now_ns)
            callback(now_ns)

        self.schedule(self.now_ns + delay_ns, due)

    def _set_motor_effects(self) -> None:
        for i, element in self.plant.structure.channels:
            command = self.plant.command[i]
            match element:
                case TorqueChannel(_, gain, delay, lag, limit):
                    if delay < 0.0:
                        raise ConfigError(
                            f"simulation.effects: torque_delay on {self.config.axes[i].name} is {delay}; a "
                            "torque cannot act before its command"
                        )
                    command[kernel.TORQUE_GAIN] *= gain
                    if delay:
                        self.plant.set_delay(i, delay)
                    if lag is not None:
                        command[kernel.HIDDEN_LAG] = _lag(self.plant.h, lag)
                    if limit is not None:
                        command[kernel.SATURATION] = limit
                case ReadingError(_, amplitude, phase):
                    command[kernel.ECCENTRICITY] = amplitude
                    command[kernel.ECCENTRICITY_PHASE] = phase
                case RepeatedRows(fraction):
                    self._drop_rate[i] = fraction

    # --- host of the nodes ---------------------------------------------------------------------
    def emit(self, node: Node, can_id: int, data: bytes, delay_ns: int = 0) -> None:
        """Put a frame of a node on the bus, with the faults that are at work on it."""
        if node.silent:
            return
        self.frames_out += 1
        if self.frame_faults or delay_ns:
            for late, changed in disturb(self.frame_faults, can_id, data, self._fault_random):
                self._transmit_after(delay_ns + round(late * _NS), can_id, changed)
        else:
            self.transmit(can_id, data)

    def _transmit_after(self, delay_ns: int, can_id: int, data: bytes) -> None:
        if delay_ns:
            self.schedule(self.now_ns + delay_ns, lambda _now: self.transmit(can_id, data))
        else:
            self.transmit(can_id, data)

    def schedule(self, due_ns: int, callback: Callable[[int], None]) -> None:
        """Call ``callback`` at ``due_ns`` or as soon as possible after."""
        self._count += 1
        heapq.heappush(self._timers, (max(due_ns, self.now_ns), self._count, callback))
        self.due_ns = self._timers[0][0]

    def rewire(self) -> None:
        """Identifiers changed: build the dispatch anew with the next frame."""
        self._dispatch = None

    # --- in from the bus -----------------------------------------------------------------------
    def receive(self, can_id: int, data: bytes, now_ns: int) -> None:
        """Take in a frame from the master, complete on the wire at ``now_ns``."""
        self.now_ns = now_ns
        self.frames_in += 1
        if not self.frame_faults:
            self.deliver(can_id, data, now_ns)
            return
        for late, changed in disturb(self.frame_faults, can_id, data, self._fault_random):
            if late:
                self.schedule(now_ns + round(late * _NS), partial(self.deliver, can_id, changed))
            else:
                self.deliver(can_id, changed, now_ns)

    def deliver(self, can_id: int, data: bytes, now_ns: int) -> None:
        """Hand a frame to every node that listens to it."""
        self.now_ns = now_ns
        for handler in (self._dispatch or self._wire_up()).get(can_id, ()):
            handler(data, now_ns)

    def _wire_up(self) -> dict[int, list[Handler]]:
        table: dict[int, list[Handler]] = {}
        for drive in self.drives:
            for can_id, handler in drive.node.handlers():
                table.setdefault(can_id, []).append(handler)
        for sync_id in {d.node.sync_id for d in self.drives} - {-1}:
            members = [d for d in self.drives if d.node.sync_id == sync_id]
            table.setdefault(sync_id, []).insert(0, self._sync_handler(members))
        self._dispatch = table
        return table

    def _sync_handler(self, members: list[Drive]) -> Handler:
        pairs = [(drive, drive.node.on_sync) for drive in members]

        def on_sync(_data: bytes, now_ns: int) -> None:
            self.syncs += 1
            self._observe(now_ns)
            self._tick_ns = now_ns
            for drive, act in pairs:
                drive.synchronous = True
                act(now_ns)

        return on_sync

    def _observe(self, now_ns: int) -> None:
        """Bring the plant up to date and let every drive measure."""
        if self._noise_row >= _NOISE_ROWS:
            if self._noisy:
                self._noise_random.standard_normal(out=self._noise)
                self._noise *= self._noise_scale
            self._noise_row = 0
        noise: Float64 = self._noise[self._noise_row]
        self._noise_row += 1
        rows = self.plant.observe(now_ns, noise)
        kept = self._drop_random.random(len(rows)) >= self._drop_rate if self._drops else None
        for i, drive in enumerate(self.drives):
            if kept is None or kept[i]:
                drive.measured = rows[i]

    # --- time ----------------------------------------------------------------------------------
    def run_timers(self, now_ns: int) -> None:
        """Call back everything due at or before ``now_ns``."""
        self.now_ns = max(now_ns, self.now_ns)
        timers = self._timers
        while timers and timers[0][0] <= now_ns:
            _, _, callback = heapq.heappop(timers)
            callback(self.now_ns)
        self.due_ns = timers[0][0] if timers else NEVER

    def _watchdog(self, now_ns: int) -> None:
        """Let the drives act by their own control period where no SYNC has come."""
        if now_ns - self._tick_ns >= _TICK_NS + _TICK_NS // 2:
            self._observe(now_ns)
            self._tick_ns = now_ns - _TICK_NS // 2  # next own tick one period from now
            for drive in self.drives:
                drive.tick(now_ns)
                drive.node.events(now_ns)
        self.schedule(self._tick_ns + _TICK_NS + _TICK_NS // 2, self._watchdog)

    def drive(self, axis: str | None) -> Drive:
        """The drive of an axis."""
        return self.drives[[a.name for a in self.config.axes].index(str(axis))]


def _put_loops(row: Float64, values: LoopValues, cycle_s: float) -> None:
    """Give the kernel's command row the loops' values and their cycle [s]; 0: they run in each sub-step."""
    row[kernel.VELOCITY_GAIN], row[kernel.POSITION_GAIN] = values.velocity_gain, values.position_gain
    row[kernel.RESET], row[kernel.CYCLE] = 1.0 / values.integral_time, cycle_s
    row[kernel.FEED_VISCOUS], row[kernel.FEED_INERTIA] = values.viscous, values.inertia
    filters = row[kernel.NOTCHES :].reshape(kernel.NOTCH_COUNT, kernel.NOTCH_SIZE)
    filters[:] = [1.0, 0.0, 0.0, 0.0, 0.0]
    if cycle_s:
        for k, notch in enumerate(values.notches):
            b, a = notch.coefficients(cycle_s)
            filters[k] = [*b, *a[1:]]


def _lag(h: float, time_constant: float) -> float:
    """Share of the way a first-order lag covers in one sub-step."""
    return 1.0 if time_constant <= 0.0 else 1.0 - math.exp(-h / time_constant)


def _address(name: str) -> tuple[int, int]:
    """(index, subindex) of "0x607D" or "0x607D:1"."""
    index, _, sub = name.partition(":")
    return int(index, 0), int(sub or "0", 0)
