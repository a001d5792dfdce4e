"""Values of loops in the objects of drives: rows of a table, each with its source.

Only objects whose number and unit were read in a public source are here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from invid.errors import InputError
from invid.tuning.axis_loop import AxisLoop
from invid.tuning.motor_scale import MotorScale
from invid_drivers.cia402.objects import Object

_EPOS4 = (
    "EPOS4 Firmware Specification 6.2.63 and 6.2.65, as cited in github.com/Imcab/EposLib 42fe757, "
    'include/epos4/configs/Configs.hpp (0x30AE:20 to :23, "same units as VelocityControlConfigs")'
)
_AX8000 = "infosys.beckhoff.com/content/1033/"


@dataclass(frozen=True)
class DriveValue:
    """One object: what it takes of an axis at its motor, and the unit of one count of it.

    ``value`` (loop, motor) in ``unit``; ``source`` where number and unit were read.
    """

    at: Object
    unit: str
    value: Callable[[AxisLoop, MotorScale], float]
    source: str

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


@dataclass(frozen=True)
class DriveValues:
    """The objects of one drive, whether they count in amperes, and what they cannot hold, in sentences."""

    name: str
    rows: tuple[DriveValue, ...]
    in_amperes: bool
    losses: tuple[str, ...]

    def motor(self, axis: str, motors: Mapping[str, MotorScale]) -> MotorScale:
        """How an axis hangs at its motor; InputError where the objects need what is not stated."""
        found = motors.get(axis)
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


DRIVES = {
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
    ),
}  # fmt: skip
