"""What drives hold now in the objects of their loops; reads and nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from invid.config import CellConfig
from invid.errors import InputError
from invid.tuning.axis_loop import AxisLoop
from invid.tuning.motor_scale import MotorScale
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.access import Access
from invid_drivers.cia402.objects import Object
from invid_drivers.connect import connect
from invid_drivers.values.rows import DRIVES, DriveValue, DriveValues

_SETS = {0x60F6: "torque control", 0x60F9: "velocity control", 0x60FB: "position control"}
"""Sets of parameters of CiA 402: where a drive has them, number and unit of each are its maker's."""
_MOST_SUBS = 8
_LIMITS = (od.MAX_TORQUE, od.MAX_CURRENT, od.MAX_VELOCITY, od.FOLLOWING_WINDOW)


@dataclass(frozen=True)
class Present:
    """The values of one axis' drive.

    ``values`` in the units of their rows; ``loop`` ``None`` where they do not say all of it; ``others`` are
    objects that are read and not understood, or not of loops, in sentences.
    """

    axis: str
    node_id: int
    drive: DriveValues | None
    values: Mapping[DriveValue, float]
    loop: AxisLoop | None
    others: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "axis": self.axis,
            "node_id": self.node_id,
            "drive": None if self.drive is None else self.drive.name,
            "complete": self.loop is not None,
            "values": [
                {"object": row.at.address, "name": row.at.name, "value": value, "unit": row.unit}
                for row, value in self.values.items()
            ],
            "others": list(self.others),
        }


def values_of(drive: Access) -> DriveValues | None:
    """The rows of a drive, by the config's vendor or by what the drive says that it is."""
    named = DRIVES.get(drive.config.vendor)
    if named is not None:
        return named
    said = (drive.find(od.VENDOR_ID), drive.find(od.PRODUCT_CODE))
    return next((d for d in DRIVES.values() if d.identity == said), None)


def read_present(drives: Sequence[Access], motors: Mapping[str, MotorScale]) -> tuple[Present, ...]:
    """What the drives hold; InputError where their units need a gear or torque constant that is missing."""
    return tuple(_read(d, motors) for d in drives)


def _read(drive: Access, motors: Mapping[str, MotorScale]) -> Present:
    known = values_of(drive)
    if known is None:
        others = (*_limits(drive), *_unknown_sets(drive))
        return Present(drive.name, drive.node_id, None, {}, None, others)
    found = {row: data for row in known.rows if (data := drive.peek(row.at)) is not None}
    values = {row: row.unpack(data) for row, data in found.items()}
    motor = known.motor(drive.name, motors)
    whole = known.loop is not None and len(values) == len(known.rows)
    loop = known.loop({r.at.name: v for r, v in values.items()}, motor) if whole and known.loop else None
    return Present(drive.name, drive.node_id, known, values, loop, _limits(drive))


def _limits(drive: Access) -> tuple[str, ...]:
    found = [(what, drive.find(what)) for what in _LIMITS]
    return tuple(f"{what.address} {what.name} is {value}" for what, value in found if value is not None)


def _unknown_sets(drive: Access) -> tuple[str, ...]:
    said = []
    for index, name in _SETS.items():
        for sub in range(1, _MOST_SUBS + 1):
            data = drive.peek(Object(index, sub, "I", name))
            if data is not None:
                value = int.from_bytes(data, "little")
                said.append(f"0x{index:04X}:{sub} of the {name} set is {value}, in its maker's own unit")
    return tuple(said)


def present_values(config: CellConfig, motors: Mapping[str, MotorScale]) -> tuple[Present, ...]:
    """``read_present`` of the cell behind a config; BusError where its bus cannot be opened.

    No state changes: drives are asked by SDO alone.
    """
    cell = connect(config)
    try:
        cell.listen()
        return read_present(cell.drives, motors)
    finally:
        cell.close()


def known_loops(found: Sequence[Present]) -> dict[str, AxisLoop]:
    """The loops of the axes whose drives say all of them; InputError where none does."""
    loops = {p.axis: p.loop for p in found if p.loop is not None}
    if not loops:
        said = "; ".join(f"{p.axis}: {p.drive.name if p.drive else 'no row for this drive'}" for p in found)
        raise InputError(
            f"--from-drive: no drive's objects say all of its loops ({said})",
            way_out="state the present values yourself with --before TUNING.json",
        )
    return loops
