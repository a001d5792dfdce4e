"""Values of loops in the objects of drives: rows of a table, each with its source.

Only objects whose number and unit were read in a public source are here. A row is written into a drive only
where its range is known too, here or from the drive's EDS.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from invid.errors import InputError
from invid.tuning.axis_loop import AxisLoop
from invid.tuning.feedforward import Feedforward
from invid.tuning.motor_scale import MotorScale
from invid.tuning.servo_loop import Gains, Notch
from invid_drivers.cia402.objects import Object

_EPOS4 = (
    "EPOS4 Firmware Specification 6.2.63 and 6.2.65, as cited in github.com/Imcab/EposLib 42fe757, "
    'include/epos4/configs/Configs.hpp (0x30AE:20 to :23, "same units as VelocityControlConfigs")'
)
_AX8000 = "infosys.beckhoff.com/content/1033/"
_OWN = "drivers/invid_drivers/simulated/loops.py"


@dataclass(frozen=True)
class DriveValue:
    """One object: what it takes of an axis at its motor, and the unit of one count of it.

    ``value`` (loop, motor) in ``unit``; ``source`` where number and unit were read; ``most`` the largest that
    it takes, the least is 0; ``None``: not known.
    """

    at: Object
    unit: str
    value: Callable[[AxisLoop, MotorScale], float]
    source: str
    most: float | None = None

    def count(self, value: float) -> float | int:
        """The number that the object takes; InputError where it does not fit."""
        if self.at.code == "f":
            return float(f"{value:.7g}")
        whole = round(value)
        if not 0 <= whole < 1 << (8 * self.at.size):
            raise InputError(
                f"{self.at.address} ({self.at.name}) cannot take {whole} {self.unit}; check gear and torque "
                "constant"
            )
        return whole

    def pack(self, value: float) -> bytes:
        """Bytes of ``count`` of a value."""
        return struct.pack("<" + self.at.code, self.count(value))

    def unpack(self, data: bytes) -> float:
        """The value that bytes of the object say."""
        return float(struct.unpack("<" + self.at.code, data.ljust(self.at.size, b"\0")[: self.at.size])[0])


@dataclass(frozen=True)
class DriveValues:
    """The objects of one drive, whether they count in amperes, and what they cannot hold, in sentences.

    ``at_axis``: they count at the axis, so that no gear is asked for. ``identity``: 0x1018:1 and :2 of a
    drive that is known by them. ``loop`` reads the values back; ``None`` where the objects do not say all of
    it.
    """

    name: str
    rows: tuple[DriveValue, ...]
    in_amperes: bool
    losses: tuple[str, ...]
    at_axis: bool = False
    identity: tuple[int, int] | None = None
    loop: Callable[[Mapping[str, float], MotorScale], AxisLoop] | None = None
    """From values by the name of their row."""

    def motor(self, axis: str, motors: Mapping[str, MotorScale]) -> MotorScale:
        """How an axis hangs at its motor; InputError where the objects need what is not stated."""
        found = motors.get(axis)
        if self.at_axis:
            return found or MotorScale()
        if found is None or (self.in_amperes and found.torque_constant_Nm_per_A is None):
            needed = "gear and torque_constant_Nm_per_A" if self.in_amperes else "gear"
            raise InputError(
                f"--motors: {self.name} counts at the motor's shaft, and {needed} of {axis} is not stated",
                way_out=f"a line an axis, as {axis}: {{gear: 100, torque_constant_Nm_per_A: 0.1}}",
            )
        return found


def _shaft(torque: float, motor: MotorScale) -> float:
    """A torque per angle, speed or acceleration of the axis as one at the motor's shaft."""
    return torque / motor.gear**2


def _microamps(torque: float, motor: MotorScale) -> float:
    return 1e6 * _shaft(torque, motor) / (motor.torque_constant_Nm_per_A or 1.0)


NOTCHES = 2
"""Filters of the simulated drive."""
LARGEST = 1e9


def _notch(number: int, name: str) -> Callable[[AxisLoop, MotorScale], float]:
    def value(loop: AxisLoop, motor: MotorScale) -> float:
        notches = loop.gains.notches
        return float(getattr(notches[number], name)) if number < len(notches) else 0.0

    return value


def _integral_time(loop: AxisLoop) -> float:
    """0 where nothing is integrated."""
    return loop.gains.integral_time if math.isfinite(loop.gains.integral_time) else 0.0


def _own(index: int, sub: int, name: str, unit: str, value: Callable[[AxisLoop], float]) -> DriveValue:
    return DriveValue(Object(index, sub, "f", name), unit, lambda a, m: value(a), _OWN, LARGEST)


_FILTER = (("frequency", "Hz"), ("zero_damping", ""), ("pole_damping", ""))


def _own_loop(values: Mapping[str, float], motor: MotorScale) -> AxisLoop:
    found = [
        [values[f"notch {k} {name.replace('_', ' ')}"] for name, _ in _FILTER] for k in range(1, NOTCHES + 1)
    ]
    gains = Gains(
        values["velocity gain"],
        values["integral time"] or math.inf,
        values["position gain"],
        tuple(Notch(*n) for n in found if n[0]),
    )
    return AxisLoop(gains, Feedforward(values["inertia feedforward"], None, values["viscous feedforward"]))


def _ax8000_loop(values: Mapping[str, float], motor: MotorScale) -> AxisLoop:
    """Without the inertia that its acceleration feedforward acts on, which is not read."""
    gains = Gains(
        values["velocity control proportional gain"] * motor.gear**2,
        values["velocity control integral action time"] or math.inf,
        values["position control proportional gain"],
    )
    return AxisLoop(gains, Feedforward(0.0, None))


DRIVES = {
    "invid": DriveValues(
        "invid's simulated drive",
        (
            _own(0x2500, 1, "velocity gain", "N·m·s/rad", lambda a: a.gains.velocity_gain),
            _own(0x2500, 2, "integral time", "s", _integral_time),
            _own(0x2500, 3, "position gain", "1/s", lambda a: a.gains.position_gain),
            _own(0x2500, 4, "inertia feedforward", "kg·m²", lambda a: a.feedforward.inertia),
            _own(0x2500, 5, "viscous feedforward", "N·m·s/rad", lambda a: a.feedforward.viscous),
            *(
                DriveValue(
                    Object(0x2501 + k, sub, "f", f"notch {k + 1} {name.replace('_', ' ')}"), unit,
                    _notch(k, name), _OWN, LARGEST,
                )
                for k in range(NOTCHES)
                for sub, (name, unit) in enumerate(_FILTER, 1)
            ),
        ),
        False,
        ("dry friction, weight and shaper have no object here",),
        at_axis=True,
        identity=(0, 0x402),
        loop=_own_loop,
    ),
    "epos4": DriveValues(
        "maxon EPOS4",
        (
            DriveValue(
                Object(0x30A2, 1, "I", "velocity controller P gain"), "µA·s/rad",
                lambda a, m: _microamps(a.gains.velocity_gain, m), _EPOS4,
            ),
            DriveValue(
                Object(0x30A2, 2, "I", "velocity controller I gain"), "µA/rad",
                lambda a, m: _microamps(a.gains.velocity_gain / a.gains.integral_time, m), _EPOS4,
            ),
            DriveValue(
                Object(0x30A2, 3, "I", "velocity controller FF velocity gain"), "µA·s/rad",
                lambda a, m: _microamps(a.feedforward.viscous, m), _EPOS4,
            ),
            DriveValue(
                Object(0x30A2, 4, "I", "velocity controller FF acceleration gain"), "µA·s²/rad",
                lambda a, m: _microamps(a.feedforward.inertia, m), _EPOS4,
            ),
        ),
        True,
        (
            "the EPOS4 closes its position loop by a PID (0x30A1) whose units of P and D were not read: "
            "close the position loop in the master, or enter P, I and D of the document by hand",
            "notch filters, dry friction, weight and shaper have no object here",
            "the EPOS4 takes its speed from an observer (0x30A3), not from a difference: margins differ",
        ),
    ),
    "beckhoff_ax8000": DriveValues(
        "Beckhoff AX8000, channel A",
        (
            DriveValue(
                Object(0x3140, 1, "f", "velocity control proportional gain"), "N·m·s/rad",
                lambda a, m: _shaft(a.gains.velocity_gain, m), f"{_AX8000}amp8000_object/18780003211.html",
            ),
            DriveValue(
                Object(0x3140, 2, "f", "velocity control integral action time"), "s",
                lambda a, m: a.gains.integral_time, f"{_AX8000}amp8000_object/18780004747.html",
            ),
            DriveValue(
                Object(0x30C0, 1, "f", "position control proportional gain"), "1/s",
                lambda a, m: a.gains.position_gain, f"{_AX8000}ax8xxx_object/11604829451.html",
            ),
            DriveValue(
                Object(0x3062, 1, "f", "velocity feed forward gain"), "",
                lambda a, m: 1.0, f"{_AX8000}ax8xxx_object/11604798347.html",
            ),
            DriveValue(
                Object(0x3062, 3, "f", "acceleration feed forward gain"), "",
                lambda a, m: 1.0 if a.feedforward.inertia else 0.0,
                f"{_AX8000}ax8xxx_object/11604801419.html",
            ),
        ),
        False,
        (
            "notch filters: the AX8000 has biquads, whose objects were not found; dry friction (0x3144), "
            "weight and shaper likewise",
            "acceleration feedforward acts on the inertia of the load at the motor in 0x3140:07, which is "
            "not written: the motor's own (0x32C0:0B) is the drive's to know",
            "TwinCAT takes a startup list; the DCF holds the same objects and values",
        ),
        loop=_ax8000_loop,
    ),
}  # fmt: skip
