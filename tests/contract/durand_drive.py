"""Drives of another author: `durand` nodes, another plant, another state machine.

Nothing of the simulated drives is used. The drives do not enforce their limits in torque mode, have no brake
unless told, lose their torque while it closes, and may carry a load.

A drive's spec: ``node_id``, ``masses`` (one or two), ``spring``, ``gravity`` (torque on the last mass),
``brake_delay`` (null: no brake), ``lacks`` (indices), ``values`` (index to value), ``enable`` (seconds until
torque), ``opposed`` (the encoder counts against the motor), ``shows`` (0x6077 per torque), ``stops_by``
(0x605A that is carried out, whatever was written), ``power_in_operational`` (torque is gone in any other NMT
state), ``follows`` (0x6065 counts).
"""

from __future__ import annotations

import math
from typing import Any

from durand import MinimalNode, Record, Variable
from durand.datatypes import DatatypeEnum as DT
from durand.network import NetworkABC
from durand.services.nmt import StateEnum

COUNTS = 1 << 20
PER_RAD = COUNTS / (2 * math.pi)
RATED = 10.0
SUBSTEP = 0.00025
LOOP = 2 * math.pi * 15.0

OBJECTS: dict[int, tuple[DT, str, int]] = {
    0x1000: (DT.UNSIGNED32, "ro", 0x00020192),
    0x6007: (DT.INTEGER16, "rw", 1),
    0x603F: (DT.UNSIGNED16, "ro", 0),
    0x6040: (DT.UNSIGNED16, "rw", 0),
    0x6041: (DT.UNSIGNED16, "ro", 0x0040),
    0x605A: (DT.INTEGER16, "rw", 2),
    0x605E: (DT.INTEGER16, "rw", 2),
    0x6060: (DT.INTEGER8, "rw", 0),
    0x6061: (DT.INTEGER8, "ro", 0),
    0x6064: (DT.INTEGER32, "ro", 0),
    0x6065: (DT.UNSIGNED32, "rw", 0xFFFFFFFF),
    0x6066: (DT.UNSIGNED16, "rw", 0),
    0x6071: (DT.INTEGER16, "rw", 0),
    0x6072: (DT.UNSIGNED16, "rw", 3000),
    0x6076: (DT.UNSIGNED32, "ro", round(1000 * RATED)),
    0x6077: (DT.INTEGER16, "ro", 0),
    0x607A: (DT.INTEGER32, "rw", 0),
    0x607F: (DT.UNSIGNED32, "rw", 0xFFFFFFFF),
    0x6084: (DT.UNSIGNED32, "rw", round(2 * PER_RAD)),
    0x6085: (DT.UNSIGNED32, "rw", round(10 * PER_RAD)),
    0x6502: (DT.UNSIGNED32, "ro", 1 << 7 | 1 << 9),
}
RECORDS: dict[int, tuple[DT, str, tuple[int, ...]]] = {
    0x1016: (DT.UNSIGNED32, "rw", (0,)),
    0x607D: (DT.INTEGER32, "rw", (-(2**31), 2**31 - 1)),
    0x608F: (DT.UNSIGNED32, "rw", (COUNTS, 1)),
}
BITS = {
    "switch on disabled": 0x40, "ready to switch on": 0x21, "switched on": 0x23, "operation enabled": 0x27,
    "quick stop active": 0x07, "fault reaction": 0x0F, "fault": 0x08,
}  # fmt: skip


class Axis:
    """Motor, perhaps a spring and a second mass, a load, a brake, a prop until the drive first holds."""

    def __init__(self, spec: dict[str, Any]) -> None:
        self.masses, self.spring = spec["masses"], spec.get("spring", 0.0)
        self.gravity, self.brake_delay = spec.get("gravity", 0.0), spec.get("brake_delay")
        self.x = [0.0] * len(self.masses)
        self.v = [0.0] * len(self.masses)
        if len(self.masses) == 2:
            self.x[1] = -self.gravity / self.spring
        self.torque = 0.0
        self.energised = False
        self.propped = True
        self.brake_closes: float | None = 0.0
        self.mark()

    def mark(self) -> None:
        self.origin = self.x[0]
        self.travel = self.speed = self.commanded = self.by_loop = 0.0
        self.powered_speed = self.powered_travel = 0.0

    def energise(self, on: bool, now: float) -> None:
        if on and not self.energised:
            self.propped = False
            self.brake_closes = None
        elif self.energised and not on and self.brake_delay is not None:
            self.brake_closes = now + self.brake_delay
        self.energised = on

    def step(self, h: float, now: float) -> None:
        """Semi-implicit Euler; far below the period of the spring."""
        braked = self.brake_delay is not None and self.brake_closes is not None and now >= self.brake_closes
        force = [0.0] * len(self.masses)
        force[-1] -= self.gravity
        if len(self.masses) == 2:
            pull = self.spring * (self.x[1] - self.x[0]) + 0.02 * math.sqrt(self.spring) * (
                self.v[1] - self.v[0]
            )
            force[0] += pull
            force[1] -= pull
        force[0] += self.torque - 0.02 * self.v[0]
        for k, mass in enumerate(self.masses):
            if k == 0 and not self.energised and (self.propped or braked):
                self.v[0] = 0.0
                continue
            self.v[k] += h * force[k] / mass
            self.x[k] += h * self.v[k]
        self.travel = max(self.travel, abs(self.x[0] - self.origin))
        self.speed = max(self.speed, abs(self.v[0]))
        if self.energised:
            self.powered_speed = max(self.powered_speed, abs(self.v[0]))
            self.powered_travel = self.travel


class Drive:
    """The device profile on a durand node, typed from the standard's figure."""

    def __init__(self, port: NetworkABC, spec: dict[str, Any]) -> None:
        self.port, self.axis = port, Axis(spec)
        self.node = MinimalNode(port, spec["node_id"])
        self.enable_s = spec.get("enable", 0.0)
        self.state = "switch on disabled"
        self.before = 0
        self.enables: float | None = None
        self.reference = self.speed = 0.0
        self.ramp = 0.0
        self.ends_in: str | None = None
        self.heard: float | None = None
        self.now = 0.0
        self.sign = -1.0 if spec.get("opposed") else 1.0
        self.turned = 1.0
        """-1 after a wire of the motor has changed its place."""
        self.frozen: float | None = None
        self.shows, self.stops_by = spec.get("shows", 1.0), spec.get("stops_by")
        self.power_in_operational = spec.get("power_in_operational", False)
        self.follows, self.lost = spec.get("follows", False), 0.0
        lacks = set(spec.get("lacks", ()))
        values = {int(k, 0): v for k, v in spec.get("values", {}).items()}
        od = self.od = self.node.object_dictionary
        for index, (kind, access, value) in OBJECTS.items():
            if index not in lacks:
                od[index] = Variable(kind, access, values.get(index, value))
        for index, (kind, access, subs) in RECORDS.items():
            if index not in lacks:
                record = Record()
                for sub, value in enumerate(subs, start=1):
                    record[sub] = Variable(kind, access, value)
                od[index] = record
        od[0x1018][4] = Variable(DT.UNSIGNED32, "ro", 7000 + spec["node_id"])
        od.download_callbacks[(0x6040, 0)].add(self.control)
        od.download_callbacks[(0x6060, 0)].add(self.mode)
        self.node.nmt.state_callbacks.add(self.nmt)

    def number(self, index: int, sub: int = 0, missing: int = 0) -> int:
        return int(self.od.read(index, sub)) if index in self.od else missing

    @property
    def seen(self) -> float:
        """What the encoder shows [rad]."""
        return self.sign * self.axis.x[0] if self.frozen is None else self.frozen

    # --- commands ------------------------------------------------------------------------------
    def mode(self, mode: int) -> None:
        self.od.write(0x6061, 0, mode)
        self.here()

    def here(self) -> None:
        self.reference, self.speed, self.ramp = self.seen, 0.0, 0.0

    def control(self, word: int) -> None:
        before, self.before = self.before, word
        state = self.state
        if word & 0x80:
            if not before & 0x80 and state == "fault":
                self.enter("switch on disabled")
        elif state in ("fault", "fault reaction"):
            return
        elif not word & 0x02:
            self.enter("switch on disabled")
        elif not word & 0x04:
            if state == "operation enabled":
                self.quick_stop()
            elif state != "quick stop active":
                self.enter("switch on disabled")
        elif word & 0x0F == 0x06:
            if state in ("switch on disabled", "switched on", "operation enabled"):
                self.enter("ready to switch on")
        elif word & 0x0F == 0x07:
            if state in ("ready to switch on", "operation enabled"):
                self.enter("switched on")
        elif word & 0x0F == 0x0F:
            if state == "switched on" and self.enables is None:
                self.enables = self.now + self.enable_s
            elif state == "quick stop active" and self.number(0x605A, missing=2) in (5, 6):
                self.enter("operation enabled")

    def enter(self, state: str) -> None:
        self.state, self.enables, self.ends_in = state, None, None
        on = state in ("operation enabled", "quick stop active", "fault reaction")
        if on and not self.axis.energised:
            self.here()
        self.axis.energise(on, self.now)
        if not on:
            self.axis.torque = 0.0

    def quick_stop(self) -> None:
        option = self.number(0x605A, missing=2) if self.stops_by is None else self.stops_by
        if option == 0:
            self.enter("switch on disabled")
            return
        self.enter("quick stop active")
        self.stop_on(0x6084 if option in (1, 5) else 0x6085)
        self.ends_in = None if option in (5, 6) else "switch on disabled"

    def stop_on(self, ramp: int) -> None:
        self.here()
        self.speed = self.sign * self.axis.v[0] if self.frozen is None else 0.0
        self.ramp = max(self.number(ramp, missing=round(10 * PER_RAD)) / PER_RAD, 1e-3)

    def connection_lost(self) -> None:
        option = self.number(0x6007)
        if self.state != "operation enabled" or option == 0:
            return
        if option == 3:
            self.quick_stop()
        elif option == 1:
            self.enter("fault reaction")
            self.stop_on(0x6085)
            self.ends_in = "fault"
        else:
            self.enter("switch on disabled")

    def nmt(self, state: StateEnum) -> None:
        if state is not StateEnum.OPERATIONAL:
            if self.power_in_operational:
                self.enter("switch on disabled")
            self.connection_lost()

    def hear(self, can_id: int, data: bytes) -> None:
        watch = self.number(0x1016, 1)
        if watch & 0xFFFF and can_id == 0x700 + (watch >> 16 & 0x7F):
            self.heard = self.now
        if can_id == 0x80 or can_id == 0x600 + self.node.node_id:
            self.publish()
        callback = self.port.subscriptions.get(can_id)
        if callback is not None:
            callback(can_id, data)

    # --- time ----------------------------------------------------------------------------------
    def step(self, h: float, now: float) -> None:
        self.now = now
        axis = self.axis
        watch = self.number(0x1016, 1) & 0xFFFF
        if self.heard is not None and watch and now - self.heard > watch / 1000:
            self.heard = None
            self.connection_lost()
        if self.enables is not None and now >= self.enables:
            self.enter("operation enabled")
        loop = True
        if self.state == "operation enabled":
            mode = self.number(0x6061)
            if mode == 10:
                loop = False
                axis.torque = self.turned * RATED * self.number(0x6071) / 1000
                axis.commanded = max(axis.commanded, abs(axis.torque))
            elif mode == 8:
                self.reference = self.number(0x607A) / PER_RAD
                self.speed = 0.0
            else:
                axis.torque, loop = 0.0, False
        elif not axis.energised:
            loop = False
        if loop:
            if self.ramp:
                self.reference += self.speed * h
                change = self.ramp * h
                self.speed -= math.copysign(min(change, abs(self.speed)), self.speed)
            total = sum(axis.masses)
            speed = self.sign * axis.v[0] if self.frozen is None else 0.0
            wanted = total * LOOP**2 * (self.reference - self.seen) + 1.4 * total * LOOP * (
                self.speed - speed
            )
            most = RATED * self.number(0x6072, missing=3000) / 1000
            axis.torque = self.turned * max(-most, min(most, wanted))
            axis.by_loop = max(axis.by_loop, abs(axis.torque))
            if self.ends_in is not None and self.speed == 0.0 and abs(axis.v[0]) < 0.005:
                self.enter(self.ends_in)
            self.watch_following(h)
        axis.step(h, now)

    def watch_following(self, h: float) -> None:
        """0x6065 over 0x6066, in position mode."""
        window = self.number(0x6065)
        away = abs(self.reference - self.seen) * PER_RAD
        self.lost = self.lost + h if self.follows and away > window else 0.0
        if self.state == "operation enabled" and self.lost and self.lost >= self.number(0x6066) / 1000:
            self.enter("fault reaction")
            self.stop_on(0x6085)
            self.ends_in = "fault"

    def publish(self) -> None:
        od, word = self.od, 0x0010 | BITS[self.state]
        if self.node.nmt.state is StateEnum.OPERATIONAL:
            word |= 0x0200
        if self.state == "operation enabled":
            word |= 0x1000
        od.write(0x6041, 0, word)
        od.write(0x6064, 0, round(self.seen * PER_RAD))
        shown = self.shows * self.turned * self.axis.torque / RATED
        od.write(0x6077, 0, max(-32768, min(32767, round(shown * 1000))))
