"""Drives of another style on a wire in virtual time, whose true motion judges what a run did.

Nothing here is shared with the simulated drives of the package or with `durand`: SDO, NMT, PDO and the device
profile are typed from CiA 301 and 402-2 as tables, the plant is one mass with a load, a brake and a prop.
Time is virtual: the computer is never late. What is asked of a drive is counted at the drive, what is
claimed is collected from the product's words.
"""

from __future__ import annotations

import heapq
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can

from invid.config import CellConfig
from invid.errors import InvidError
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.journal import Journal
from invid_drivers.measurement import MeasurementResult, run_measurement
from invid_drivers.stopping_budgets import plan_within

BITS = 16
PER_RAD = (1 << BITS) / (2 * math.pi)
RATED = 10.0
LIMIT, WINDOW, SPEED = 20.0, 0.5, 5.0
LOAD = 8.0
CYCLE = 0.002
TICK = 0.0005
LOOP_HZ = 12.0

NOT_THERE, READ_ONLY, NOT_NOW = 0x06020000, 0x06010002, 0x08000022
OFF, READY, ON, ENABLED, STOPPING, FAULT = "off", "ready", "on", "enabled", "stopping", "fault"
WORD = {OFF: 0x40, READY: 0x21, ON: 0x23, ENABLED: 0x27, STOPPING: 0x07, FAULT: 0x08}
NEXT = {  # command of the controlword: state before to state after
    "shutdown": {OFF: READY, ON: READY, ENABLED: READY},
    "switch on": {READY: ON, ENABLED: ON},
    "enable": {ON: ENABLED, STOPPING: ENABLED},
    "voltage off": {READY: OFF, ON: OFF, ENABLED: OFF, STOPPING: OFF},
    "quick stop": {READY: OFF, ON: OFF, ENABLED: STOPPING},
}
DICTIONARY: dict[int, tuple[str, int | None, int]] = {
    # index << 8 | sub: struct code, value, 1 where it can be written
    0x100000: ("I", 0x00020192, 0), 0x100600: ("I", 0, 1), 0x101600: ("B", 1, 0), 0x101601: ("I", 0, 1),
    0x101700: ("H", 0, 1), 0x101801: ("I", 0x0000F00D, 0), 0x101802: ("I", 0x00000402, 0),
    0x101804: ("I", 0, 0), 0x600700: ("h", 1, 1), 0x603F00: ("H", 0, 0), 0x604000: ("H", 0, 1),
    0x604100: ("H", 0x40, 0), 0x605A00: ("h", 2, 1), 0x606000: ("b", 0, 1), 0x606100: ("b", 0, 0),
    0x606400: ("i", 0, 0), 0x606500: ("I", 0xFFFFFFFF, 1), 0x606600: ("H", 0, 1), 0x607100: ("h", 0, 1),
    0x607200: ("H", 10_000, 1), 0x607600: ("I", round(1000 * RATED), 0), 0x607700: ("h", 0, 0),
    0x607A00: ("i", 0, 1), 0x607D01: ("i", -(1 << 31), 1), 0x607D02: ("i", (1 << 31) - 1, 1),
    0x607F00: ("I", 0xFFFFFFFF, 1), 0x608400: ("I", round(2 * PER_RAD), 1),
    0x608500: ("I", round(10 * PER_RAD), 1), 0x608F01: ("I", 1 << BITS, 0), 0x608F02: ("I", 1, 0),
    0x650200: ("I", 1 << 7 | 1 << 9, 0),
    0x140001: ("I", 0x80000000, 1), 0x140002: ("B", 255, 1), 0x160000: ("B", 0, 1), 0x160001: ("I", 0, 1),
    0x160002: ("I", 0, 1), 0x160003: ("I", 0, 1), 0x180001: ("I", 0x80000000, 1), 0x180002: ("B", 255, 1),
    0x1A0000: ("B", 0, 1), 0x1A0001: ("I", 0, 1), 0x1A0002: ("I", 0, 1), 0x1A0003: ("I", 0, 1),
}  # fmt: skip


@dataclass
class Habits:
    """What one drive, its plant and its brake do; the defaults are an ordinary one without a load."""

    load: float = 0.0
    """Torque that pulls it down [N·m]; positive torque holds it."""
    mass: float = 1.0
    brake: float | None = None
    """Seconds from voltage off until it has closed; ``None``: no brake."""
    brake_opens: float = 0.0
    """Seconds from enabling until it has opened."""
    brake_good: int = 1 << 30
    """Closings until it holds no longer."""
    enable: float = 0.0
    stops_from_torque: bool = True
    """A quick stop from torque mode holds; else it shows quick stop active and gives no torque."""
    lies: bool = False
    """0x605A is taken, and the axis coasts in quick stop active."""
    gives: float = math.inf
    """What it gives at most, whatever was written (I²t) [N·m]."""
    shown_early: float = 0.0
    """0x6061 shows a mode so long before it acts."""
    blank: float = 0.0
    """0x6061 is −1 for so long, then the mode acts."""
    modes_at_rest: bool = False
    """0x6060 is taken without power only."""
    opposed: bool = False
    turned: bool = False
    """A motor whose torque has turned; 0x6077 shows what was asked."""
    frozen: float | None = None
    """Where the encoder has stopped [rad]."""
    sdo: float = 0.0003
    pdo: float = 0.0002
    event: float | None = None
    """Its TPDO also comes every so many seconds."""
    values: dict[int, int] = field(default_factory=dict)


class ForeignDrive:
    """One node: object dictionary, device profile, loop and plant."""

    def __init__(self, wire: ForeignWire, node: int, habits: Habits) -> None:
        self.wire, self.node, self.habits = wire, node, habits
        self.od: dict[int, list[Any]] = {at: list(entry) for at, entry in DICTIONARY.items()}
        self.od[0x101804][1] = 9000 + node
        for at, value in habits.values.items():
            self.od[at] = [self.od[at][0] if at in self.od else "H", value, 1]
        self.nmt = 0x7F
        self.state, self.mode = OFF, 0
        self.changes: tuple[float, int] | None = None
        self.enabling: float | None = None
        self.watch_from: float | None = None
        self.next_beat = self.next_event = 0.0
        self.x = self.v = self.torque = 0.0
        self.reference = self.fading = 0.0
        self.limp = False
        self.propped, self.closings = True, 0
        self.braked_from: float | None = 0.0
        self.opens_at = 0.0
        self.asked = self.most_torque = self.most_asked = 0.0
        self.log: list[tuple[float, float, float, str]] = []

    # --- the dictionary ------------------------------------------------------------------------
    def value(self, at: int) -> int:
        return int(self.od[at][1]) if at in self.od else 0

    def sdo(self, data: bytes) -> None:
        head, index, sub = data[0], data[1] | data[2] << 8, data[3]
        at = index << 8 | sub
        entry = self.od.get(at)
        if entry is None:
            self._abort(data, NOT_THERE)
        elif head == 0x40:
            code = entry[0]
            size = struct.calcsize(code)
            body = struct.pack("<" + code, self._shown(at)).ljust(4, b"\0")
            self._answer(bytes((0x43 | 4 - size << 2, *data[1:4])) + body)
        elif head >> 5 == 1:
            size = struct.calcsize(entry[0])
            value = struct.unpack("<" + entry[0], data[4 : 4 + size])[0]
            if not entry[2]:
                self._abort(data, READ_ONLY)
            elif at == 0x606000 and self.habits.modes_at_rest and self.powered:
                self._abort(data, NOT_NOW)
            else:
                entry[1] = value
                self._written(at, value)
                self._answer(bytes((0x60, *data[1:4])) + bytes(4))

    def _shown(self, at: int) -> int:
        if at == 0x606400:
            return self.counts
        if at == 0x607700:
            return self.permille
        if at == 0x604100:
            return self.word
        return self.value(at)

    def _written(self, at: int, value: int) -> None:
        if at == 0x604000:
            self.control(value)
        elif at == 0x606000:
            h = self.habits
            self.od[0x606100][1] = -1 if h.blank else value
            self.changes = self.wire.now + (h.blank or h.shown_early), value
            if not (h.blank or h.shown_early):
                self._take_mode()

    def _take_mode(self) -> None:
        if self.changes is not None and self.wire.now >= self.changes[0] - 1e-9:
            self.mode = self.changes[1]
            self.od[0x606100][1] = self.mode
            self.changes = None
            self.reference = self.seen

    def _answer(self, data: bytes) -> None:
        self.wire.post(0x580 + self.node, data, self.habits.sdo)

    def _abort(self, request: bytes, code: int) -> None:
        self._answer(bytes((0x80, *request[1:4])) + struct.pack("<I", code))

    # --- the profile ---------------------------------------------------------------------------
    @property
    def powered(self) -> bool:
        return self.state in (ENABLED, STOPPING)

    @property
    def word(self) -> int:
        return WORD[self.state] | 0x10 | (0x1000 if self.state == ENABLED else 0)

    @property
    def seen(self) -> float:
        if self.habits.frozen is not None:
            return self.habits.frozen
        return -self.x if self.habits.opposed else self.x

    @property
    def seen_speed(self) -> float:
        if self.habits.frozen is not None:
            return 0.0
        return -self.v if self.habits.opposed else self.v

    @property
    def counts(self) -> int:
        return math.floor(self.seen * PER_RAD)

    @property
    def permille(self) -> int:
        return max(-32768, min(32767, round(1000 * self.shown_torque / RATED)))

    @property
    def shown_torque(self) -> float:
        return -self.torque if self.habits.turned else self.torque

    def control(self, word: int) -> None:
        if not word & 2:
            command = "voltage off"
        elif not word & 4:
            command = "quick stop"
        else:
            command = {6: "shutdown", 7: "switch on", 15: "enable"}.get(word & 0x0F, "")
        after = NEXT.get(command, {}).get(self.state)
        if after is None:
            if command != "enable":
                self.enabling = None
            return
        if after == ENABLED and self.state == ON:
            if self.enabling is None:
                self.enabling = self.wire.now + self.habits.enable
            if self.wire.now < self.enabling:
                return
        self.enter(after)

    def enter(self, state: str) -> None:
        option = self.value(0x605A00)
        if state == STOPPING and option == 0:
            state = OFF
        before, self.state, self.enabling = self.powered, state, None
        if self.powered and not before:
            self.propped, self.braked_from = False, None
            self.opens_at = self.wire.now + self.habits.brake_opens
            self.reference, self.fading = self.seen, 0.0
        elif before and not self.powered:
            self.closings += 1
            self.torque = 0.0
            if self.habits.brake is not None and self.closings <= self.habits.brake_good:
                self.braked_from = self.wire.now + self.habits.brake
        if state == STOPPING:
            self.reference, self.fading = self.seen, self.seen_speed
            self.limp = self.habits.lies or (self.mode == 10 and not self.habits.stops_from_torque)
        elif state == ENABLED:
            self.limp = False

    def master_lost(self) -> None:
        option = self.value(0x600700)
        if self.state == ENABLED and option == 3:
            self.enter(STOPPING)
        elif self.powered and option in (1, 2):
            self.enter(OFF)

    def hear(self, cob: int, data: bytes) -> None:
        if cob == 0x000 and data[1] in (0, self.node):
            self.nmt = {0x01: 0x05, 0x02: 0x04, 0x80: 0x7F}.get(data[0], self.nmt)
            if data[0] in (0x02, 0x80):
                self.master_lost()
        elif cob == 0x600 + self.node and self.nmt != 0x04:
            self.sdo(data)
        elif cob == 0x080 and self.nmt == 0x05 and self.value(0x180002) == 1:
            self.publish()
        elif cob == 0x200 + self.node and self.nmt == 0x05 and not self.value(0x140001) >> 31:
            word, torque = struct.unpack("<Hh", data)
            self.od[0x607100][1] = torque
            self.od[0x604000][1] = word
            self.control(word)
        elif self.value(0x101601) & 0xFFFF and cob == 0x700 + (self.value(0x101601) >> 16 & 0x7F):
            self.watch_from = self.wire.now

    def publish(self) -> None:
        if not self.value(0x180001) >> 31:
            self.wire.post(
                0x180 + self.node, struct.pack("<ihH", self.counts, self.permille, self.word), self.habits.pdo
            )

    # --- time ----------------------------------------------------------------------------------
    def tick(self, h: float) -> None:
        now, habits = self.wire.now, self.habits
        if self.changes is not None:
            self._take_mode()
        beat = self.value(0x101700) / 1000
        if beat and now >= self.next_beat:
            self.next_beat = now + beat
            self.wire.post(0x700 + self.node, bytes((self.nmt,)), 0.0001)
        watch = self.value(0x101601) & 0xFFFF
        if self.watch_from is not None and watch and now - self.watch_from > watch / 1000:
            self.watch_from = None
            self.master_lost()
        if habits.event is not None and self.nmt == 0x05 and now >= self.next_event:
            self.next_event = now + habits.event
            self.publish()
        if self.powered:
            self._drive(h)
        force = self.torque - habits.load
        if (self.propped and not self.powered) or self._braked(now):
            self.v = 0.0
        else:
            self.v += h * (force - 0.02 * self.v) / habits.mass
            self.x += h * self.v
        self.most_torque = max(self.most_torque, abs(self.torque))
        self.log.append((now, self.x, self.torque, self.state))

    def _braked(self, now: float) -> bool:
        if self.powered:
            return self.habits.brake is not None and now < self.opens_at
        return self.habits.brake is not None and self.braked_from is not None and now >= self.braked_from

    def _drive(self, h: float) -> None:
        habits = self.habits
        if self.state == ENABLED and self.mode == 10:
            wanted = RATED * self.value(0x607100) / 1000
            self.most_asked = max(self.most_asked, abs(wanted))
        elif self.state == STOPPING or self.mode == 8:
            if self.state == ENABLED:
                self.reference, self.fading = (
                    (self.value(0x607A00) + 0.5) / PER_RAD,
                    0.0,
                )
            else:
                ramp = h * self.value(0x608500) / PER_RAD
                self.reference += h * self.fading
                self.fading -= math.copysign(min(ramp, abs(self.fading)), self.fading)
            w = 2 * math.pi * LOOP_HZ
            wanted = habits.mass * (
                w * w * (self.reference - self.seen) + 1.6 * w * (self.fading - self.seen_speed)
            )
        else:
            wanted = 0.0
        if self.limp:
            wanted = 0.0
        scale = RATED / 1000
        most = min(habits.gives, scale * self.value(0x607200))
        up = min(most, scale * self.value(0x60E000)) if 0x60E000 in self.od else most
        down = min(most, scale * self.value(0x60E100)) if 0x60E100 in self.od else most
        given = max(-down, min(up, wanted))
        self.torque = -given if habits.turned else given
        if (
            self.state == STOPPING
            and self.value(0x605A00) not in (5, 6)
            and self.fading == 0.0
            and (abs(self.seen_speed) < 0.01 or self.limp)
        ):
            self.enter(OFF)


class _Clock:
    def __init__(self, wire: ForeignWire) -> None:
        self._wire = wire

    def now(self) -> float:
        return self._wire.now

    def sleep_until(self, instant: float) -> None:
        self._wire.advance(instant)


class ForeignWire(can.BusABC):
    """The master's end: what is sent reaches every drive at once, what drives say comes after its time."""

    def __init__(self, habits: list[Habits]) -> None:
        self.channel_info = "foreign"
        self.now = 0.0
        self._ticked = 0
        self.clock = _Clock(self)
        self._order = 0
        self._queue: list[tuple[float, int, int, bytes]] = []
        self._latest = 0.0
        self.late: Callable[[float], float] = lambda now: 0.0
        """Seconds by which the adapter delays what it hands over."""
        self.events: list[tuple[float, Callable[[], None]]] = []
        self.sent: list[tuple[float, int, bytes]] = []
        self.each: Callable[[], None] | None = None
        """Called at every tick: whatever a situation waits for."""
        self.drives = [ForeignDrive(self, n, h) for n, h in enumerate(habits, start=1)]
        super().__init__(channel="foreign")

    def post(self, cob: int, data: bytes, after: float) -> None:
        self._order += 1
        due = (
            max(self._latest, self.now + after + self.late(self.now))
            if self.late(self.now)
            else self.now + after
        )
        self._latest = max(self._latest, due)
        heapq.heappush(self._queue, (due, self._order, cob, data))

    def at(self, seconds: float, what: Callable[[], None]) -> None:
        self.events.append((seconds, what))
        self.events.sort(key=lambda e: e[0])

    def advance(self, until: float) -> None:
        while (self._ticked + 1) * TICK <= until + 1e-12:
            self._ticked += 1
            self.now = self._ticked * TICK
            while self.events and self.now >= self.events[0][0]:
                self.events.pop(0)[1]()
            if self.each is not None:
                self.each()
            for drive in self.drives:
                drive.tick(TICK)
        self.now = max(self.now, until)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        data = bytes(msg.data)
        self.sent.append((self.now, msg.arbitration_id, data))
        for drive in self.drives:
            drive.hear(msg.arbitration_id, data)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        end = self.now + (timeout or 0.0)
        while True:
            if self._queue and self._queue[0][0] <= self.now + 1e-12:
                _, _, cob, data = heapq.heappop(self._queue)
                return can.Message(arbitration_id=cob, data=data, is_extended_id=False, timestamp=self.now)
            if self.now >= end - 1e-12:
                return None
            due = self._queue[0][0] if self._queue else end
            self.advance(min(end, due, (self._ticked + 1) * TICK))

    def shutdown(self) -> None:
        """The wire stays for the next command."""


@dataclass(frozen=True)
class Run:
    """One `measure`: how it ended, and in what words."""

    error: InvidError | None
    result: MeasurementResult | None

    @property
    def words(self) -> str:
        if self.error is not None:
            return str(self.error)
        assert self.result is not None
        return " ".join(self.result.warnings)


class ForeignCell:
    """A cell of foreign drives, and the commands that are given to it one after another."""

    def __init__(self, folder: Path, habits: list[Habits], axes: list[dict[str, Any]], **bus: Any) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self.wire = ForeignWire(habits)
        self.drives = self.wire.drives
        limits = {"torque_Nm": LIMIT, "position_window_rad": WINDOW, "velocity_rad_per_s": SPEED}
        self.config = CellConfig.model_validate(
            {
                "format": "invid-config",
                "robot": "foreign",
                "bus": {"interface": "socketcan", "channel": "foreign", "cycle_s": CYCLE, **bus},
                "axes": [
                    {"name": f"A{n}", "node_id": n, "limits": limits, "inertia_kgm2": 1.0, **axis}
                    for n, axis in enumerate(axes, start=1)
                ],
                "experiments": [
                    {"kind": "multisine", "amplitude": 0.2, "band_Hz": [2, 20], "period_s": 1, "periods": 2}
                ],
            }
        )
        self.stop: Any = None

    def connect(self) -> Cia402Cell:
        return Cia402Cell(self.wire, self.config, journal=Journal(self.folder / "bus.journal"))

    def measure(self, stop: Any = None, on_phase: Callable[[str], None] = lambda phase: None) -> Run:
        """`invid measure`, in this process: time is virtual. ``on_phase`` hears where it is, "stop" too."""
        cell = self.connect()
        leave = cell.stop

        def leaving() -> None:
            on_phase("stop")
            leave()

        cell.stop = leaving  # type: ignore[method-assign]
        try:
            cell.check()
            plan = plan_within(self.config, cell.reports).plan
        except InvidError as error:
            cell.close()
            return Run(error, None)
        try:
            out = self.folder / "rec.h5"
            done = run_measurement(
                self.config, plan, cell, out, stop=stop, progress=lambda now: on_phase(now.phase)
            )
            return Run(None, done)
        except InvidError as error:
            return Run(error, None)

    def fallen(self, axis: int = 0, since: float = 0.0) -> float:
        """How far the plant of an axis was from where it stood at an instant [rad]."""
        places = [x for now, x, _, _ in self.drives[axis].log if now >= since]
        return max(abs(x - places[0]) for x in places)
