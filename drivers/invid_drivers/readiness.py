"""Whether a cell may be measured, and with what plan: one answer for check, dry run, run and service."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from invid.config import CellConfig
from invid.errors import InvidError
from invid.planning import Plan
from invid.planning.budget import RoundTrip, tolerable_share
from invid.planning.forecast import fit_to_limits
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.hold_memory import HoldMemory
from invid_drivers.cia402.holding import Reason, remembered, to_support
from invid_drivers.cia402.journal import journal_path
from invid_drivers.connect import connect, is_virtual
from invid_drivers.round_trip import probe, require
from invid_drivers.stopping_budgets import Budgets, Wish, plan_within


@dataclass(frozen=True)
class Prepared:
    """Plan, config and budgets of a measurement, with all that is known before a drive is enabled."""

    plan: Plan
    config: CellConfig
    """With the tightest limits of config, drives and EDS, and the permitted speeds."""
    budgets: Budgets
    said: tuple[str, ...]
    """What a person must know of it beside the plan's own warnings."""
    round_trip: RoundTrip | None = None
    """Of the adapter, where it was probed."""


def prepare(
    cell: Cia402Cell,
    config: CellConfig,
    wish: Wish = Wish(),
    *,
    probes: bool | None = None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Prepared:
    """Ask the drives of a connected cell, plan within what they leave, and see that the adapter carries it.

    Parameters
    ----------
    probes
        Whether the adapter is probed; default: where hardware stands behind the config.

    Raises
    ------
    ConfigError, DriveError, BusError
        The first thing that keeps a measurement from starting.
    """
    if not cell.reports:
        cell.check()
    found = plan_within(config, cell.reports, wish)
    plan = fit_to_limits(found.plan, config, found.config)
    said, trip = found.said, None
    if not config.simulated if probes is None else probes:
        trip = probe(cell.link, config, plan, cancelled)
        said = (*said, *require(trip, config))
        if not trip.carries and not config.simulated:
            cycles = sum(e.cycles for e in plan.experiments)
            cell.expect_answers(tolerable_share(cycles, config.safety.missed_tpdos), trip.shortest_cycle_s)
    return Prepared(plan, found.config, found.budgets, said, trip)


def foresee(config: CellConfig, wish: Wish = Wish()) -> Prepared:
    """Do as ``prepare``, but touch no bus that hardware may be on: its drives are taken at their best.

    Raises
    ------
    ConfigError, DriveError
        What ``prepare`` would refuse whatever the drives say; in virtual time, what it refuses.
    """
    if is_virtual(config):
        cell = connect(config)
        try:
            return prepare(cell, config, wish)
        finally:
            cell.close()
    found = plan_within(config, None, wish)
    return Prepared(found.plan, found.config, found.budgets, found.said)


def loads_to_support(config: CellConfig) -> tuple[str, ...]:
    """Axes whose hold after a stop the next measurement tries: what they carry must not be able to fall far.

    None where no hardware stands behind the config.
    """
    if config.simulated:
        return ()
    return to_support(config, HoldMemory.beside(journal_path(config.bus.interface, config.bus.channel)))


def support_sentence(axes: Sequence[str]) -> str:
    """What a person does about these axes before anything moves."""
    return (
        f"how {', '.join(axes)} is held after a stop was not seen yet; where it carries a load, that is "
        "tried first, at rest. Support it so that it cannot fall far and still hangs on its drive"
    )


def not_ready(config: CellConfig) -> tuple[Reason, ...]:
    """Reasons of axes that an earlier run left energised, or at which it ended; empty: none.

    The bus is opened only where there was one: then the drives say whether they still are, as in ``check``.
    """
    if is_virtual(config):
        return ()
    said = remembered(config, HoldMemory.beside(journal_path(config.bus.interface, config.bus.channel)))
    if not said:
        return ()
    try:
        cell = connect(config)
    except InvidError:
        return said
    try:
        cell.check()
        return cell.not_ready
    except InvidError:
        return said
    finally:
        cell.close()
