"""The cycle told to a drive: 0x1006, by which it watches SYNC, and 0x60C2, over which it interpolates."""

from __future__ import annotations

import contextlib

from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.access import WriteRefused
from invid_drivers.cia402.axis import Drive


def tell_cycle(drive: Drive, cycle_s: float) -> None:
    """Write the cycle where the drive has the objects; one that it refuses stays as it was."""
    values = [(od.SYNC_PERIOD, round(cycle_s * 1e6))]
    interpolation = interpolation_time(cycle_s)
    if interpolation is not None:
        value, exponent = interpolation
        values += [(od.INTERPOLATION_EXPONENT, exponent), (od.INTERPOLATION_VALUE, value)]
    for what, number in values:
        if drive.find(what) is None:
            continue
        with contextlib.suppress(WriteRefused):
            drive.write(what, number)


def interpolation_time(cycle_s: float) -> tuple[int, int] | None:
    """0x60C2: value and power of ten [s], the largest power first; ``None`` where no byte holds the cycle."""
    for exponent in (-3, -4, -5, -6):
        value = cycle_s / 10.0**exponent
        if abs(value - round(value)) < 1e-6 and 1 <= round(value) <= 255:
            return round(value), exponent
    return None
