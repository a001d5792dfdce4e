"""An axis of CiA 402: states, options, modes, its loops and its plant; `Habit`s change what it does."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from .dictionary import AXIS, PER_RAD, RATED
from .habits import Habit, overriding
from .plant import STEP_S, Plant

if TYPE_CHECKING:
    from .node import Node

OFF, READY, ON, ENABLED = "off", "ready", "on", "enabled"
STOPPING, REACTING, FAULT = "stopping", "reacting", "fault"
STATES = (OFF, READY, ON, ENABLED, STOPPING, REACTING, FAULT)
WORD = {OFF: 0x50, READY: 0x31, ON: 0x33, ENABLED: 0x37, STOPPING: 0x17, REACTING: 0x1F, FAULT: 0x18}
POWERED = (ENABLED, STOPPING, REACTING)
LOOP_HZ, TORQUE, POSITION = 10.0, 10, 8
PEAK = 4.0
"""What the motor gives at most, of its rated torque."""
AT_REST = 0.02
"""Speed at which a ramp has ended [rad/s]."""


class Axis:
    """One power drive system."""

    def __init__(self, node: Node, k: int, plant: Plant, habits: list[Habit]) -> None:
        self.node, self.base, self.plant = node, k * AXIS << 8, plant
        self.hooks = overriding(habits)
        self.name = f"{node.node}" if k == 0 else f"{node.node}.{k}"
        self.switch_on_s, self.enable_s, self.mode_s = 0.02, 0.01, 0.0
        self.brake_first = True
        """Its brake closes under torque at the end of a ramp."""
        self.faults_by_following = True
        self.boot()

    def boot(self) -> None:
        """Without power, as after its supply has come."""
        self.state, self.mode = OFF, 0
        self.word_before = 0
        self.due: tuple[float, str] | None = None
        """A state that it is on the way to, and when it is there."""
        self.changes: tuple[float, int] | None = None
        self.closes: float | None = None
        self.opens: float | None = None
        self.ends_in: str | None = None
        self.locked_out = False
        """Its enable input is open, or its torque is safely off."""
        self.reference = self.speed = self.integral = self.wanted = 0.0
        self.asked = 0.0
        """What torque mode was told [N·m]."""
        self.target: float | None = None
        self.ramp = 0.0
        self.following_s = 0.0
        self.power(False)

    def take_up(self, habit: Habit) -> None:
        """Change in the middle of its life."""
        habit.start(self)
        for name, own in overriding([habit]).items():
            self.hooks[name] += own

    # --- dictionary --------------------------------------------------------------------------------
    def number(self, at: int, missing: int = 0) -> int:
        """A value of this axis."""
        entry = self.node.od.get(at + self.base)
        return missing if entry is None else entry.value

    def put(self, at: int, value: int) -> None:
        """Set a value from inside."""
        self.node.od[at + self.base].value = value

    def refuses(self, at: int, value: int) -> int | None:
        """Abort code of a write; 0: taken without effect; ``None``: taken."""
        for habit in self.hooks["refuses"]:
            answer = habit.refuses(self, at, value)
            if answer is not None:
                return answer
        return None

    def disturbed(self, at: int, *, is_write: bool) -> int | None:
        """Abort code of an SDO that a habit disturbs."""
        for habit in self.hooks["disturbs"]:
            code = habit.disturbs(self, at, is_write)
            if code is not None:
                return code
        return None

    def written(self, at: int, value: int) -> None:
        """React to a write."""
        if at == 0x604000:
            self.control(value)
        elif at == 0x606000:
            if value != self.mode or self.changes is not None:
                self.changes = self.node.world.now + self.mode_s, value
                if not self.mode_s:
                    self.take_mode()
        elif at == 0x607A00:
            self.target = self.place_of(value)

    def shown(self, at: int, value: int) -> int:
        """What it shows of an object."""
        if at == 0x604100:
            value = WORD[self.state] | (0x200 if self.node.nmt == 5 else 0)
            value |= 0x20 if self.state not in (STOPPING, REACTING) else 0
            value |= 0x1000 if self.state == ENABLED and self.mode in (TORQUE, POSITION) else 0
        elif at == 0x606100:
            value = self.mode
        elif at == 0x606400:
            value = self.wrap(math.floor(self.encoder() * PER_RAD * self.gear()))
        elif at == 0x607700:
            value = round(1000 * self.plant.torque / RATED)
        for habit in self.hooks["shows"]:
            value = habit.shows(self, at, value)
        return value

    def gear(self) -> float:
        """Counts of 0x6064 to one of the encoder (0x6093), with the sign of 0x607E."""
        ratio = self.number(0x609301, 1) / max(self.number(0x609302, 1), 1)
        return -ratio if self.number(0x607E00) & 0x80 else ratio

    def wrap(self, counts: int) -> int:
        """Counts within 0x607B, or 32 bits."""
        low, high = self.number(0x607B01), self.number(0x607B02)
        low, span = (low, high - low + 1) if low < high else (-(1 << 31), 1 << 32)
        return (counts - low) % span + low

    def place_of(self, counts: int) -> float:
        """Where a target is [rad]: the nearest such place."""
        low, high = self.number(0x607B01), self.number(0x607B02)
        span = high - low + 1 if low < high else 1 << 32
        here = math.floor(self.encoder() * PER_RAD * self.gear())
        counts = here + (counts - here + span // 2) % span - span // 2
        return (counts + 0.5) / PER_RAD / self.gear()

    def encoder(self) -> float:
        """What its encoder shows [rad]."""
        q = self.plant.q
        for habit in self.hooks["encoder"]:
            q = habit.encoder(self, q)
        return q

    def encoder_speed(self) -> float:
        """What it takes its speed for [rad/s]."""
        v = self.plant.v
        for habit in self.hooks["encoder_speed"]:
            v = habit.encoder_speed(self, v)
        return v

    # --- states ------------------------------------------------------------------------------------
    @property
    def is_powered(self) -> bool:
        """Whether its power stage is on."""
        return self.state in POWERED

    def control(self, word: int) -> None:
        """Commands of the controlword (figure 5 and table 30 of CiA 402-2)."""
        before, self.word_before = self.word_before, word
        if self.state == FAULT:
            if word & 0x80 and not before & 0x80:
                self.enter(OFF, "fault reset")
        elif self.state == REACTING:
            return
        elif not word & 2:
            self.enter(OFF, "disable voltage")
        elif not word & 4:
            if self.state == ENABLED:
                self.quick_stop("quick stop")
            elif self.state in (READY, ON):
                self.enter(OFF, "quick stop")
        elif self.locked_out:
            return
        elif word & 0x0F == 0x06:
            if self.state in (OFF, ON):
                self.enter(READY, "shutdown")
            elif self.state == ENABLED:
                self.leave_by(self.number(0x605B00), READY, "shutdown")
        elif word & 0x0F == 0x07:
            if self.state == READY:
                self.head_for(ON, self.switch_on_s)
            elif self.state == ENABLED:
                self.leave_by(self.number(0x605C00, 1), ON, "disable operation")
        elif word & 0x0F == 0x0F:
            if self.state == READY:
                self.head_for(ON, self.switch_on_s)
            elif self.state == ON:
                self.head_for(ENABLED, self.enable_s)
            elif self.state == STOPPING and self.number(0x605A00) >= 5:
                self.enter(ENABLED, "enable")

    def head_for(self, state: str, seconds: float) -> None:
        """Take so long to a state."""
        if self.due is None or self.due[1] != state:
            self.due = self.node.world.now + seconds, state

    def leave_by(self, option: int, state: str, why: str) -> None:
        """Leave operation enabled by an option: at once, or by a ramp (which still shows enabled)."""
        if option == 0:
            self.enter(state, why)
        elif self.ends_in is None:
            self.start_ramp(0x608400)
            self.ends_in = state

    def quick_stop(self, why: str) -> None:
        """Transition 11 by 0x605A."""
        option = self.number(0x605A00, 2)
        for habit in self.hooks["quick_stop_option"]:
            option = habit.quick_stop_option(self, option)
        if option == 0:
            self.enter(OFF, f"{why}, option 0")
            return
        self.enter(STOPPING, f"{why}, option {option}")
        self.start_ramp(0x608400 if option in (1, 5) else 0x608500)
        self.ends_in = OFF if option < 5 else None

    def start_ramp(self, at: int) -> None:
        """Bring the reference to rest from where the axis is."""
        self.reference, self.speed = self.encoder(), self.encoder_speed()
        self.ramp = max(self.number(at, round(10 * PER_RAD)) / PER_RAD / abs(self.gear()), 0.1)
        self.integral = self.wanted

    def fault(self, code: int) -> None:
        """Fault, by 0x605E where it is under power."""
        self.put(0x603F00, code)
        self.node.emergency(code)
        if self.state in (ENABLED, STOPPING) and self.number(0x605E00, 2) != 0:
            self.enter(REACTING, f"fault {code:04X}")
            self.start_ramp(0x608500)
            self.ends_in = FAULT
        else:
            self.enter(FAULT, f"fault {code:04X}")

    def connection_lost(self, code: int) -> None:
        """0x6007, where something moves."""
        if self.state != ENABLED:
            return
        option = self.number(0x600700)
        for habit in self.hooks["abort_option"]:
            option = habit.abort_option(self, option)
        self.node.world.note(self.name, f"master lost ({code:04X}), option {option}")
        if option == 1:
            self.fault(code)
        elif option == 2:
            self.enter(OFF, "master lost")
        elif option == 3:
            self.quick_stop("master lost")

    def left_operational(self) -> None:
        """NMT took it out of operational."""
        for habit in self.hooks["left_operational"]:
            habit.left_operational(self)
        self.connection_lost(0x8120)

    def enter(self, state: str, why: str) -> None:
        """Be in a state."""
        if state == self.state:
            return
        world, before = self.node.world, self.state
        plant = self.plant
        world.note(self.name, f"{before} to {state} ({why}) q={plant.q:.4f} v={plant.v:.3f}")
        was = self.is_powered
        self.state, self.due, self.ends_in = state, None, None
        if was != self.is_powered:
            self.power(self.is_powered)
        for habit in self.hooks["entered"]:
            habit.entered(self, before)

    def power(self, on: bool) -> None:
        """Power stage on or off, and the brake with it."""
        plant, now = self.plant, self.node.world.now
        if on:
            plant.prop = None
            self.closes, self.opens = None, now + plant.opens
            self.wanted = self.integral = 0.0
            self.hold_here()
        else:
            self.opens, self.wanted = None, 0.0
            if plant.brake is not None and not plant.closed and self.closes is None:
                self.closes = now + plant.brake

    def hold_here(self) -> None:
        """Its loop begins where the axis is."""
        self.reference, self.speed, self.ramp = self.encoder(), 0.0, 0.0
        if self.mode == POSITION and self.target is not None and self.state == ENABLED:
            self.reference = self.target
        self.integral = self.wanted

    def take_mode(self) -> None:
        """A mode that was asked for acts."""
        assert self.changes is not None
        self.mode, self.changes = self.changes[1], None
        if self.state == ENABLED:
            self.hold_here()

    # --- time --------------------------------------------------------------------------------------
    def tick(self, now: float) -> None:
        """One step of timers, loop and plant."""
        plant = self.plant
        for habit in self.hooks["tick"]:
            habit.tick(self, now)
        if self.changes is not None and now >= self.changes[0]:
            self.take_mode()
        if self.due is not None and now >= self.due[0]:
            state = self.due[1]
            if {ON: READY, ENABLED: ON}[state] == self.state and not self.locked_out:
                self.enter(state, "command")
            self.due = None
        if self.opens is not None and now >= self.opens:
            plant.closed, self.opens = False, None
        if self.closes is not None and now >= self.closes:
            plant.closed, self.closes = True, None
            for habit in self.hooks["brake_closed"]:
                habit.brake_closed(self)
        self.asked = 0.0
        if not self.is_powered:
            plant.step(None)
            return
        most = self.limit()
        self.wanted = max(-most[1], min(most[0], self.loop(most)))
        given = self.wanted
        for habit in self.hooks["gives"]:
            given = habit.gives(self, given)
        plant.step(given)
        if self.ends_in is not None and self.speed == 0.0 and abs(self.encoder_speed()) < AT_REST:
            self.end_ramp(now)

    def end_ramp(self, now: float) -> None:
        """At rest: the brake first, where it has one and closes it under torque."""
        plant = self.plant
        assert self.ends_in is not None
        if plant.brake is None or not self.brake_first or plant.closed:
            self.enter(self.ends_in, "end of ramp")
        elif self.closes is None:
            self.closes = now + plant.brake

    def limit(self) -> tuple[float, float]:
        """Most torque up and down [N·m]."""
        most = min(self.number(0x607200, 10**6) / 1000, PEAK) * RATED
        up = min(most, self.number(0x60E000, 10**6) / 1000 * RATED)
        down = min(most, self.number(0x60E100, 10**6) / 1000 * RATED)
        for habit in self.hooks["limits"]:
            up, down = habit.limits(self, up, down)
        return up, down

    def loop(self, most: tuple[float, float]) -> float:
        """Torque that mode or ramp asks for [N·m]."""
        ramps = self.state in (STOPPING, REACTING) or self.ends_in is not None
        if not ramps and self.mode == TORQUE:
            self.asked = (self.number(0x607100) + self.number(0x60B200)) / 1000 * RATED
            return self.asked
        if not ramps and self.mode != POSITION:
            return 0.0
        if ramps:
            change = self.ramp * STEP_S
            self.speed = 0.0 if abs(self.speed) <= change else self.speed - math.copysign(change, self.speed)
            self.reference += self.speed * STEP_S
        elif self.target is not None:
            self.reference = self.target + self.number(0x60B000) / PER_RAD
        inertia, w = self.plant.inertia, 2 * math.pi * LOOP_HZ
        error = self.reference - self.encoder()
        u = inertia * (w * w * error + 1.6 * w * (self.speed - self.encoder_speed()))
        total = u + self.integral
        if -most[1] < total < most[0]:
            self.integral += inertia * w**3 / 5 * error * STEP_S
        if not ramps and self.faults_by_following:
            self.watch_following(abs(error) * PER_RAD)
        return total

    def watch_following(self, counts: float) -> None:
        """0x6065 for longer than 0x6066."""
        self.following_s = self.following_s + STEP_S if counts > self.number(0x606500) else 0.0
        if self.following_s and self.following_s * 1000 > self.number(0x606600):
            self.following_s = 0.0
            self.fault(0x8611)
