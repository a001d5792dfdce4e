"""The position and velocity loops of a simulated drive: the objects that hold their values, and a memory.

The drive's own area counts at the axis: 0x2500 velocity gain [N·m·s/rad or N·s/m], integral time [s],
position gain [1/s], feedforward of acceleration [kg·m² or kg] and of speed; 0x2501 and 0x2502 a notch filter
each, frequency [Hz], damping of zeros and of poles. All REAL32, kept as their bits; 0 switches off. The
EPOS4's 0x30A2 counts in µA, with the torque constant of 0x6076 over 0x6075.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from invid.errors import ConfigError
from invid.numerics.arrays import Float64
from invid.tuning.servo_loop import Notch
from invid_drivers.simulated import kernel
from invid_drivers.simulated.object_dictionary import ObjectDictionary, SdoAbort

LOOPS, FILTERS, EPOS4 = 0x2500, 0x2501, 0x30A2
SAMPLED_S = 0.001
"""Cycle of loops whose values somebody wrote, unless the config says another: that of `invid tune`."""


@dataclass(frozen=True)
class LoopValues:
    """K_v, 1/T_i [1/s], K_p, and feedforward of speed and acceleration; ``torque_constant`` [N·m/A or N/A] of
    a drive that does not show its rated torque."""

    velocity_gain: float
    position_gain: float
    reset: float = 0.0
    viscous: float = 0.0
    inertia: float = 0.0
    notches: tuple[Notch, ...] = ()
    torque_constant: float = 1.0


def bits(value: float) -> int:
    """REAL32 as the unsigned number that an object of this dictionary holds."""
    whole: int = struct.unpack("<I", struct.pack("<f", value))[0]
    return whole


def real(value: int) -> float:
    """The number of ``bits``."""
    number: float = struct.unpack("<f", struct.pack("<I", value))[0]
    return number


def add_loop_objects(od: ObjectDictionary, values: LoopValues, *, epos4: bool) -> None:
    """The objects of the loops with what they come with."""
    if epos4:
        micro = 1e6 / _torque_constant(od, values)
        gains = (values.velocity_gain, values.velocity_gain * values.reset, values.viscous, values.inertia)
        od.add_record(EPOS4, *(("I", "rw", min(round(micro * g), (1 << 32) - 1)) for g in gains))
        return
    time = 1.0 / values.reset if values.reset else 0.0
    loops = (values.velocity_gain, time, values.position_gain, values.inertia, values.viscous)
    od.add_record(LOOPS, *(("I", "rw", bits(v)) for v in loops))
    for k in range(kernel.NOTCH_COUNT):
        od.add_record(FILTERS + k, *[("I", "rw", 0)] * 3)
    for index, subs in ((LOOPS, 5), *((FILTERS + k, 3) for k in range(kernel.NOTCH_COUNT))):
        for sub in range(1, subs + 1):
            od.guard(index, sub, _require_size)


def _require_size(value: int) -> None:
    number = real(value)
    if not math.isfinite(number) or number < 0.0:
        raise SdoAbort(SdoAbort.RANGE)


def loop_values(od: ObjectDictionary, shipped: LoopValues) -> LoopValues:
    """What the objects say; ``shipped`` where the drive has none."""
    if od.find(EPOS4, 1) is not None:
        gain, integral, viscous, inertia = (
            od.number(EPOS4, sub) * 1e-6 * _torque_constant(od, shipped) for sub in range(1, 5)
        )
        reset = integral / gain if gain else 0.0
        return LoopValues(gain, shipped.position_gain, reset, viscous, inertia)
    if od.find(LOOPS, 1) is None:
        return shipped
    gain, time, position, inertia, viscous = (real(od.number(LOOPS, sub)) for sub in range(1, 6))
    found = [[real(od.number(FILTERS + k, sub)) for sub in (1, 2, 3)] for k in range(kernel.NOTCH_COUNT)]
    notches = tuple(Notch(f, zero, pole) for f, zero, pole in found if f and pole)
    return LoopValues(gain, position, 1.0 / time if time else 0.0, viscous, inertia, notches)


def _torque_constant(od: ObjectDictionary, values: LoopValues) -> float:
    """[N·m/A]: thousandths of both objects, where the drive shows them."""
    torque, current = od.number(0x6076, missing=0), od.number(0x6075, missing=0)
    return torque / current if torque and current else values.torque_constant


def loop_cycle(values: LoopValues, shipped: LoopValues, cycle_s: float) -> float:
    """Cycle [s] at which ``values`` run: the config's; where it says none, 0 for those that the drive came
    with and ``SAMPLED_S`` for those that somebody wrote."""
    came_with = not values.notches and all(
        math.isclose(getattr(values, name), getattr(shipped, name), rel_tol=1e-6)
        for name in ("velocity_gain", "position_gain", "reset", "viscous", "inertia")
    )
    return cycle_s or (0.0 if came_with else SAMPLED_S)


def put_into(row: Float64, values: LoopValues, cycle_s: float) -> None:
    """Give the kernel's command row the loops' values."""
    row[kernel.VELOCITY_GAIN], row[kernel.POSITION_GAIN] = values.velocity_gain, values.position_gain
    row[kernel.RESET], row[kernel.CYCLE] = values.reset, cycle_s
    row[kernel.FEED_VISCOUS], row[kernel.FEED_INERTIA] = values.viscous, values.inertia
    filters = row[kernel.NOTCHES :].reshape(kernel.NOTCH_COUNT, kernel.NOTCH_SIZE)
    filters[:] = [1.0, 0.0, 0.0, 0.0, 0.0]
    if cycle_s:
        for k, notch in enumerate(values.notches):
            b, a = notch.coefficients(cycle_s)
            filters[k] = [*b, *a[1:]]


class LoopMemory:
    """A file in which drives keep the objects of their loops, as one does in which they were stored."""

    def __init__(self, path: Path | None) -> None:
        self._path = path

    def recall(self, axis: str, od: ObjectDictionary) -> None:
        """Let a drive come with what it kept; ConfigError where the file is none of these."""
        if self._path is None or not self._path.exists():
            return
        try:
            kept = json.loads(self._path.read_text(encoding="utf-8")).get(axis, {})
            named = {tuple(name.split(":")): int(value) for name, value in kept.items()}
            found = {(int(index, 0), int(sub, 0)): value for (index, sub), value in named.items()}
        except (OSError, ValueError, AttributeError) as error:
            raise ConfigError(f"simulation.memory: {self._path} cannot be read: {error}") from None
        od.preset(found)

    def keep(self, drives: Mapping[str, ObjectDictionary]) -> None:
        """Write what the drives hold now."""
        if self._path is None:
            return
        kept = {
            axis: {
                f"0x{e.index:X}:{e.sub}": e.value
                for e in od
                if e.sub and e.index in (LOOPS, *range(FILTERS, FILTERS + kernel.NOTCH_COUNT), EPOS4)
            }
            for axis, od in drives.items()
        }
        self._path.parent.mkdir(parents=True, exist_ok=True)
        part = self._path.with_name(self._path.name + ".part")
        part.write_text(json.dumps(kept), encoding="utf-8")
        part.replace(self._path)
