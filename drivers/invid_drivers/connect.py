"""Config to cell."""

from __future__ import annotations

import contextlib

import can

from invid.config import CellConfig
from invid.errors import ConfigError
from invid_drivers.adapters import open_adapter
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.journal import Journal, journal_path, refuse_left_by_others
from invid_drivers.cia402.reservation import Reservation

VIRTUAL = "invid-virtual"


def is_virtual(config: CellConfig) -> bool:
    """Whether the bus steps simulated drives in virtual time."""
    return config.bus.interface == VIRTUAL


def open_bus(config: CellConfig) -> can.BusABC:
    """The bus a config names; BusError where it cannot be opened."""
    if is_virtual(config):
        if config.simulation is None:
            raise ConfigError(
                f"bus: interface {VIRTUAL!r} needs a section 'simulation' that says what stands behind it"
            )
        # A real cell needs neither simulated drives nor the compiler that they come with.
        from invid_drivers.simulated import open_virtual_bus  # noqa: PLC0415

        return open_virtual_bus(config)
    return open_adapter(config.bus)


def connect(config: CellConfig) -> Cia402Cell:
    """The cell behind a config, its bus open and nothing written yet. Call ``close`` on every way out.

    Raises
    ------
    BusError
        The bus cannot be opened, or another process measures on it.
    ConfigError
        An axis that cannot be driven.
    """
    with contextlib.ExitStack() as refused:  # then the bus is free for the next who tries
        journal = None
        if not is_virtual(config):
            path = journal_path(config.bus.interface, config.bus.channel)
            # before the journal is read: the one before may still be writing it
            reservation = Reservation(config.bus.interface, config.bus.channel)
            refused.callback(reservation.release)
            refuse_left_by_others(path)
            journal = Journal(path)
            journal.reservation = reservation
        bus = open_bus(config)
        refused.callback(bus.shutdown)
        cell = Cia402Cell(bus, config, journal=journal)
        refused.pop_all()
    return cell
