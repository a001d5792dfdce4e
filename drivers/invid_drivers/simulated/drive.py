"""The CiA 402 application of a simulated drive: states, modes, ramps, limits, fault reactions.

Angles and torques are in the plant's coordinates; ``direction`` turns them into the drive's.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from invid.errors import ConfigError
from invid_drivers.cia402.states import (
    TRANSITIONS,
    Command,
    DriveState,
    OperationMode,
    command_of,
    is_energised,
)
from invid_drivers.simulated import kernel
from invid_drivers.simulated.brake import Brake
from invid_drivers.simulated.config import AxisSimulation
from invid_drivers.simulated.limits import Limits
from invid_drivers.simulated.node import Nmt, Node
from invid_drivers.simulated.object_dictionary import Entry, ObjectDictionary, SdoAbort
from invid_drivers.simulated.plant import Plant

PROFILE_TORQUE, CYCLIC_POSITION, CYCLIC_TORQUE = OperationMode
_MODE_BITS = {int(mode): mode.supported_bit for mode in OperationMode}

_NS = 1_000_000_000
_UNLIMITED = 0xFFFF
"""Thousandths: twice what 0x6071 can ask for."""

# EMCY codes of CiA 402
FOLLOWING_ERROR, REFERENCE_LIMIT, OVERSPEED, HEARTBEAT = 0x8611, 0x8612, 0x8480, 0x8130


@dataclass(frozen=True)
class Scales:
    """In which units a drive counts, and which way."""

    rated_torque: float
    """[N·m or N]; torque is in thousandths of it."""
    counts_per_unit: float
    """Encoder counts per rad or m."""
    direction: int
    """1, or −1 where it counts against the plant."""
    linear: bool
    velocity_in_rpm: bool
    cycle_s: float
    """Of the bus: it interpolates targets over so long [s]."""
    ramp_counts: float
    """Counts/s² in one unit of 0x6084 and 0x6085."""
    own_ramp: int
    """Ramp of a drive that lacks 0x6084 or 0x6085, in their unit."""


class Drive:
    """One axis: follows its object dictionary, commands the plant."""

    def __init__(
        self,
        row: int,
        node: Node,
        plant: Plant,
        brake: Brake,
        scales: Scales,
        settings: AxisSimulation,
    ) -> None:
        if scales.rated_torque <= 0 or scales.counts_per_unit <= 0:
            raise ConfigError("simulation: rated torque and encoder counts must be positive")
        self.node, self._plant, self.row = node, plant, row
        self.rated_torque, self.counts_per_unit = scales.rated_torque, scales.counts_per_unit
        self.direction, self.brake = scales.direction, brake
        self._scales, self._settings = scales, settings
        self._enable_ns = round(settings.enable_s * _NS)
        self._limits_in_torque_mode = settings.limits_in_torque_mode
        self._counts_per_rev = 0.0 if scales.linear else 2.0 * math.pi * scales.counts_per_unit
        self._delay: deque[float] = deque([0.0] * settings.command_delay_cycles)
        self._command = plant.command[row]
        self.state = DriveState.SWITCH_ON_DISABLED
        self.measured = [0, 0, 0, 0]
        """Counts, counts/s, thousandths of rated torque; counts in the plant's sign."""
        self.synchronous = False
        """True while a tick comes from a SYNC."""
        # what faults set
        self.ignore_quick_stop = False
        self.ignore_controlword = False
        self.ignore_target = False
        self.torque_lie: int | None = None
        self.torque_gain = 1.0
        self.statusword_lie: int | None = None
        self.mode_lie: int | None = None
        od = node.od
        entry = self._entry
        self._e_controlword, self._e_statusword = entry(od, 0x6040, "H"), entry(od, 0x6041, "H")
        self._e_mode, self._e_display = entry(od, 0x6060, "b"), entry(od, 0x6061, "b")
        self._e_position, self._e_velocity = entry(od, 0x6064, "i"), entry(od, 0x606C, "i")
        self._e_torque, self._e_demand = entry(od, 0x6077, "h"), entry(od, 0x6074, "h")
        self._e_target_torque, self._e_offset = entry(od, 0x6071, "h"), entry(od, 0x60B2, "h")
        self._e_target_position, self._e_demand_position = entry(od, 0x607A, "i"), entry(od, 0x6062, "i")
        self._e_following = entry(od, 0x60F4, "i")
        self._e_max_torque = entry(od, 0x6072, "H", 3000)
        od.guard(0x6060, 0, self._check_mode)
        self.configured()
        self._torque_unit = scales.direction * scales.rated_torque / 1000.0
        self._forget()

    @staticmethod
    def _entry(od: ObjectDictionary, index: int, code: str, missing: int = 0) -> Entry:
        """The drive's entry, or a private one where the vendor left the object out."""
        return od.find(index) or Entry(index, 0, code, "rw", missing)

    def _forget(self) -> None:
        self._controlword = 0
        self.mode = self._wanted_mode = self._shown_mode = 0
        self._mode_due_ns = self._shown_due_ns = 0
        self._after_stop: DriveState | None = None
        self._stop_deadline_ns = 0
        self._demand = 0.0
        self._enable_due_ns: int | None = None
        self._target_counts: int | None = None
        self._lost_ns: int | None = None
        self._last_ns = 0
        self._internal_limit = False
        self._following = False

    # --- life ----------------------------------------------------------------------------------
    def reset(self, now_ns: int) -> None:
        """Return to power-on: nothing energised, no command remembered."""
        self._forget()
        self._enter(DriveState.SWITCH_ON_DISABLED)

    def _check_mode(self, value: int) -> None:
        if value and not self._modes & _MODE_BITS.get(value, 0):
            raise SdoAbort(SdoAbort.RANGE)
        if self._settings.mode_from_switched_on and not (
            is_energised(self.state) or self.state is DriveState.SWITCHED_ON
        ):
            raise SdoAbort(SdoAbort.STATE)

    @property
    def _modes(self) -> int:
        """Bits of 0x6502; a drive that lacks it has its modes all the same."""
        return self.node.od.number(0x6502, missing=sum(_MODE_BITS.values()))

    def _enter(self, state: DriveState) -> None:
        energised = is_energised(state)
        if energised and not is_energised(self.state):
            self._target_counts = None
            self._demand = 0.0
        self.state = state
        self._after_stop = self._enable_due_ns = None
        if not energised:
            self._command[kernel.MODE] = kernel.MODE_OFF
            self._demand = 0.0
            for i in range(len(self._delay)):
                self._delay[i] = 0.0
        self.brake.follow(energised)

    # --- one step --------------------------------------------------------------------------------
    def tick(self, now_ns: int) -> None:
        """Act on time gone by: feedback, commands, modes, supervision, statusword."""
        self._e_position.value, self._e_velocity.value, shown, _ = self.measured
        if self.torque_gain != 1.0:
            shown = max(-32768, min(32767, round(shown * self.torque_gain)))
        self._e_torque.value = shown if self.torque_lie is None else self.torque_lie
        word: int = self._e_controlword.value  # type: ignore[assignment]
        if word != self._controlword:
            self._control(word, now_ns)
        if self._enable_due_ns is not None and now_ns >= self._enable_due_ns:
            self._enter(DriveState.OPERATION_ENABLED)
        self._select_mode(now_ns)
        if self._after_stop is not None:
            self._continue_stop(now_ns)
        elif self.state is DriveState.OPERATION_ENABLED:
            self._operate(now_ns)
        if self.state is DriveState.OPERATION_ENABLED:
            self._supervise(now_ns)
        self._show()
        self._last_ns = now_ns
        self.synchronous = False

    def _control(self, word: int, now_ns: int) -> None:
        previous, self._controlword = self._controlword, word
        if self.ignore_controlword:
            return
        command = command_of(word, previous)
        if (
            command is Command.QUICK_STOP
            and self.ignore_quick_stop
            and self.state is DriveState.OPERATION_ENABLED
        ):
            return
        found = TRANSITIONS.get((self.state, command))
        if found is None:
            return
        number, target = found
        od = self.node.od
        if number == 16 and od.number(0x605A, missing=2) not in (5, 6, 7, 8):
            return
        if number == 11:
            self._quick_stop(now_ns)
        elif number in (5, 8) and od.number(0x605C if number == 5 else 0x605B, missing=0) == 1:
            self._begin_stop(target, od.number(0x6084, missing=0), now_ns)
        elif number == 15:
            od.put(0x603F, 0, 0)
            self._enter(target)
            self.node.emergency(0x0000, 0x00)
        elif number == 4:
            self._enable(now_ns)
        else:
            self._enter(target)
            if number == 3 and command is Command.ENABLE_OPERATION:
                self._enable(now_ns)

    def _enable(self, now_ns: int) -> None:
        """Do transition 4, as fast as the drive is."""
        if self._enable_ns:
            self._enable_due_ns = now_ns + self._enable_ns
        else:
            self._enter(DriveState.OPERATION_ENABLED)

    def _select_mode(self, now_ns: int) -> None:
        wanted = int(self._e_mode.value)
        if wanted != self._wanted_mode:
            self._wanted_mode, self._mode_due_ns = wanted, now_ns + round(self._settings.mode_change_s * _NS)
        due = wanted != self.mode and now_ns >= self._mode_due_ns
        if due and (wanted == 0 or self._modes & _MODE_BITS.get(wanted, 0)):
            self.mode = wanted
            self._shown_due_ns = now_ns + round(self._settings.mode_display_s * _NS)
            self._target_counts = None
            self._demand = 0.0
        if now_ns >= self._shown_due_ns:
            self._shown_mode = self.mode

    # --- modes -----------------------------------------------------------------------------------
    def _limit_torque(self, *, by_loop: bool) -> int:
        """Put the limit in force into the plant's table; return it in thousandths.

        ``by_loop``: the drive's own position loop asks for the torque, not the master.
        """
        limit = _UNLIMITED
        if by_loop or self._limits_in_torque_mode:
            limit = self._e_max_torque.value  # type: ignore[assignment]
        self._command[kernel.LIMIT] = limit * self.rated_torque / 1000.0
        return limit

    def _operate(self, now_ns: int) -> None:
        limit = self._limit_torque(by_loop=self.mode == CYCLIC_POSITION)
        wanted: float
        if self.ignore_target:
            wanted = 0.0
        elif self.mode == CYCLIC_TORQUE:
            wanted = self._e_target_torque.value + self._e_offset.value  # type: ignore[operator,assignment]
        elif self.mode == CYCLIC_POSITION:
            self._follow_position()
            return
        elif self.mode == PROFILE_TORQUE:
            target = 0.0 if self._controlword & 0x100 else float(int(self._e_target_torque.value))
            step = self.node.od.number(0x6087, missing=1000) * (now_ns - self._last_ns) * 1e-9
            wanted = self._demand + max(-step, min(step, target - self._demand))
        else:
            wanted = 0.0
        if -limit <= wanted <= limit:
            self._internal_limit = False
        else:
            wanted = limit if wanted > 0 else -limit
            self._internal_limit = True
        self._demand = wanted
        self._e_demand.value = max(-32768, min(32767, int(wanted)))
        if self._delay and self.mode == CYCLIC_TORQUE:
            if not self.synchronous:
                return
            self._delay.append(wanted)
            wanted = self._delay.popleft()
        self._command[kernel.TORQUE] = self._torque_unit * wanted
        self._command[kernel.MODE] = kernel.MODE_TORQUE

    def _saturated(self) -> bool:
        """Whether the drive's own loop asks for more torque than 0x6072 allows."""
        return abs(float(self._plant.motor_state[self.row, kernel.RECORDED])) >= 0.999 * float(
            self._command[kernel.LIMIT]
        )

    def _hold_here(self, speed: float = 0.0, deceleration: float = 0.0) -> None:
        command = self._command
        self._limit_torque(by_loop=True)
        command[kernel.POSITION] = self.measured[3] / self.counts_per_unit
        command[kernel.VELOCITY] = speed
        command[kernel.DECELERATION] = deceleration
        command[kernel.INTERPOLATE] = command[kernel.TORQUE] = 0.0
        command[kernel.MODE] = kernel.MODE_POSITION

    def _follow_position(self) -> None:
        command = self._command
        target = int(self._e_target_position.value)
        low, high = self._limits.low, self._limits.high
        self._internal_limit = self._saturated()
        if not low <= target <= high:
            target = max(low, min(high, target))
            self._internal_limit = True
        if self._target_counts is None:
            self._hold_here()
            self._target_counts = int(self._e_position.value)
        if not self.ignore_target:
            command[kernel.TORQUE] = self._torque_unit * float(int(self._e_offset.value))
        if target != self._target_counts:
            self._target_counts = target
            goal = self.direction * target / self.counts_per_unit
            command[kernel.VELOCITY] = (goal - command[kernel.POSITION]) / self._scales.cycle_s
            command[kernel.INTERPOLATE] = self._scales.cycle_s
            command[kernel.DECELERATION] = 0.0  # a ramp of an earlier stop is over
        self._e_demand_position.value = target
        error = target - int(self._e_position.value)
        self._e_following.value = max(-0x80000000, min(0x7FFFFFFF, error))

    # --- stopping --------------------------------------------------------------------------------
    def _begin_stop(self, target: DriveState, deceleration_counts: int, now_ns: int) -> None:
        """Decelerate under position control; enter ``target`` at standstill."""
        speed = self.direction * self.measured[1] / self.counts_per_unit
        deceleration = deceleration_counts * self._scales.ramp_counts / self.counts_per_unit
        if deceleration <= 0.0:
            self._enter(target)
            if is_energised(target):
                self._hold_here()  # no ramp: it is held where it is
            return
        self._hold_here(speed, deceleration)
        self._after_stop = target
        # the ramp and a tenth of a second to settle; then the drive gives up on standstill
        self._stop_deadline_ns = now_ns + round((abs(speed) / deceleration + 0.1) * 1e9)

    def _continue_stop(self, now_ns: int) -> None:
        standing = (
            self._command[kernel.VELOCITY] == 0.0 and abs(self.measured[1]) / self.counts_per_unit < 0.005
        )
        if standing or now_ns >= self._stop_deadline_ns:
            target = self._after_stop
            self._after_stop = None
            if target is not None and target is not self.state:
                self._enter(target)

    def _ramp(self, index: int) -> int:
        """A ramp in the drive's unit; its own where the object is missing."""
        return self.node.od.number(index, missing=self._scales.own_ramp)

    def _quick_stop(self, now_ns: int) -> None:
        od = self.node.od
        option = od.number(0x605A, missing=2)
        if option == 0:
            self._enter(DriveState.SWITCH_ON_DISABLED)
            return
        self._enter(DriveState.QUICK_STOP_ACTIVE)
        stay = option in (5, 6, 7, 8)
        target = DriveState.QUICK_STOP_ACTIVE if stay else DriveState.SWITCH_ON_DISABLED
        ramp = self._ramp(0x6084 if option in (1, 5) else 0x6085)
        self._begin_stop(target, ramp, now_ns)

    def fail(self, code: int, register: int, now_ns: int) -> None:
        """Do transition 13: fault reaction by 0x605E, then fault."""
        if self.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            return
        od = self.node.od
        od.put(0x603F, 0, code)
        self.node.emergency(code, register | 0x01)
        option = od.number(0x605E, missing=0)
        if self.state not in (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE) or option == 0:
            self._enter(DriveState.FAULT)
        else:
            self._enter(DriveState.FAULT_REACTION_ACTIVE)
            self._begin_stop(DriveState.FAULT, self._ramp(0x6084 if option == 1 else 0x6085), now_ns)
        self._show()

    def connection_lost(self, now_ns: int) -> None:
        """Do what 0x6007 says: 0 nothing, 1 fault, 2 disable voltage, 3 quick stop."""
        option = self.node.od.number(0x6007, missing=0)
        if option == 1:
            self.fail(HEARTBEAT, 0x10, now_ns)
        elif option == 2 and self.state not in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
            self._enter(DriveState.SWITCH_ON_DISABLED)
        elif option == 3 and self.state is DriveState.OPERATION_ENABLED:
            if not self.ignore_quick_stop:
                self._quick_stop(now_ns)
        elif option == 3 and self.state in (DriveState.READY_TO_SWITCH_ON, DriveState.SWITCHED_ON):
            self._enter(DriveState.SWITCH_ON_DISABLED)
        self._show()

    # --- supervision -----------------------------------------------------------------------------
    def configured(self) -> None:
        """Take over limits that may have been written."""
        self._limits = Limits.of(self.node.od, self._counts_per_rev, rpm=self._scales.velocity_in_rpm)

    def _supervise(self, now_ns: int) -> None:
        if self.mode != CYCLIC_POSITION and not self._limits_in_torque_mode:
            self._following = False
            return
        position, speed, _, _ = self.measured
        limits = self._limits
        if not -limits.fastest <= speed <= limits.fastest:
            self.fail(OVERSPEED, 0x20, now_ns)
            return
        if (position > limits.high and speed > 0) or (position < limits.low and speed < 0):
            self.fail(REFERENCE_LIMIT, 0x20, now_ns)
            return
        self._following = False
        window = limits.window
        if self.mode == CYCLIC_POSITION and window != math.inf and self._target_counts is not None:
            demand = self._command[kernel.POSITION] * self.counts_per_unit
            if abs(demand - self.measured[3]) > window:
                self._following = True
                if self._lost_ns is None:
                    self._lost_ns = now_ns
                if now_ns - self._lost_ns >= limits.window_ns:
                    self.fail(FOLLOWING_ERROR, 0x20, now_ns)
            else:
                self._lost_ns = None

    def _show(self) -> None:
        """Write statusword and mode display."""
        state = self.state
        word = state | 0x10  # voltage enabled
        if self.node.state is Nmt.OPERATIONAL:
            word |= 0x200
        if self._internal_limit:
            word |= 0x800
        if state is DriveState.OPERATION_ENABLED and self._after_stop is None:
            if self.mode in (CYCLIC_POSITION, CYCLIC_TORQUE):
                word |= 0 if self.ignore_target else 0x1000
                if self._following:
                    word |= 0x2000
            elif self.mode == PROFILE_TORQUE and self._demand == self._e_target_torque.value:
                word |= 0x400
        self._e_statusword.value = word if self.statusword_lie is None else self.statusword_lie
        blank = self._settings.mode_shown_enabled and not is_energised(state)
        shown = 0 if blank else self._shown_mode
        self._e_display.value = shown if self.mode_lie is None else self.mode_lie
