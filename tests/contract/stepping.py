"""Cycles of a cell made one by one, as a procedure makes them."""

from collections.abc import Sequence
from weakref import WeakKeyDictionary

from invid.sweep.ports import Mode, Sample, Want, Wish
from invid_drivers.cia402.bus import Cia402Cell

_wants: WeakKeyDictionary[Cia402Cell, list[Want]] = WeakKeyDictionary()
"""What was wished of each cell's axes last."""


def energise(cell: Cia402Cell, modes: Sequence[Mode]) -> None:
    """Every axis enabled in its mode."""
    _wants[cell] = [Want.HOLD if mode is Mode.HOLD else Want.LEAD for mode in modes]
    cell.run(cell.energise(modes))


def secure(cell: Cia402Cell, loaded: Sequence[bool]) -> bool:
    """The stop test; every axis is held afterwards."""
    _wants[cell] = [Want.HOLD] * len(loaded)
    return cell.run(cell.secure(loaded))


def set_modes(cell: Cia402Cell, modes: Sequence[Mode]) -> None:
    """Wish for other modes from here on."""
    _wants[cell] = [Want.HOLD if mode is Mode.HOLD else Want.LEAD for mode in modes]
    for axis, want in zip(cell._supervised.axes, _wants[cell], strict=True):
        cell._supervised.grant(axis, want)


def exchange(cell: Cia402Cell, torque: Sequence[float]) -> Sample:
    """One cycle with these torques."""
    return cell.tick(Wish(_wants[cell], torque))
