"""Whether a cell may be measured, and with what plan: one answer for check, dry run, run and service."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from invid.config import CellConfig
from invid.errors import InvidError
from invid.planning import Plan, make_plan
from invid.planning.budget import RoundTrip, tolerable_share
from invid.planning.forecast import fit_to_limits
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.journal import journal_path
from invid_drivers.cia402.reservation import Reservation
from invid_drivers.cia402.standing.hold_memory import HoldMemory
from invid_drivers.cia402.standing.holding import Reason, remembered, to_support
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


def require_plan(config: CellConfig, wish: Wish) -> None:
    """ConfigError for what no drive could change: before a bus is opened, or a process started."""
    if wish.plan is None:
        make_plan(config, axes=wish.axes, amplitude_scale=wish.amplitude_scale, model=wish.model)


def foresee(config: CellConfig, wish: Wish = Wish(), *, why: str = "") -> Prepared:
    """Do as ``prepare``, but touch no bus that hardware may be on: its drives are taken at their best.

    Raises
    ------
    ConfigError, DriveError
        What ``prepare`` would refuse whatever the drives say; in virtual time, what it refuses.
    """
    if is_virtual(config) and not why:
        cell = connect(config)
        try:
            return prepare(cell, config, wish)
        finally:
            cell.close()
    found = plan_within(config, None, wish)
    return Prepared(found.plan, found.config, found.budgets, (why, *found.said) if why else found.said)


def ask_drives(config: CellConfig, wish: Wish = Wish()) -> Prepared:
    """Do as ``prepare``; where nobody can be asked the drives are taken at their best, and why is said."""
    require_plan(config, wish)
    try:
        cell = connect(config)
    except InvidError as error:
        return foresee(config, wish, why=f"the drives were not asked, the limits are the config's: {error}")
    try:
        try:
            cell.check()
        except InvidError as error:
            why = f"the drives are not ready, the limits are the config's: {error}"
            return foresee(config, wish, why=why)
        return prepare(cell, config, wish)
    finally:
        cell.close()


def loads_to_support(config: CellConfig) -> tuple[str, ...]:
    """Axes whose hold after a stop the next measurement tries: what they carry must not be able to fall far.

    None where no hardware stands behind the config.
    """
    if config.simulated:
        return ()
    return to_support(config, _memory(config))


def support_sentence(axes: Sequence[str]) -> str:
    """What a person does about these axes before anything moves."""
    return (
        f"how {', '.join(axes)} is held after a stop was not seen yet; where it carries a load, that is "
        "tried first, at rest. Support it so that it cannot fall far and still hangs on its drive"
    )


def not_ready(config: CellConfig) -> tuple[Reason, ...]:
    """Reasons of axes that an earlier run left energised, or at which it ended, as of when that was seen.

    Nothing is asked or sent: what the drives say now is for ``invid check``, which writes to them.
    """
    return () if is_virtual(config) else remembered(config, _memory(config))


@dataclass(frozen=True)
class Asked:
    """What the drives of a cell said when they were asked."""

    reasons: tuple[Reason, ...]
    """Axes that are energised though nobody measures, or at which a run ended."""
    refusal: InvidError | None
    """The first thing that keeps a measurement from starting."""
    said: tuple[str, ...]
    """What is to be known beside: of drives, bus, limits and adapter."""


def ask(config: CellConfig, wish: Wish = Wish()) -> Asked:
    """Ask the drives what ``invid check`` asks, and restore what an earlier run left in them.

    This writes to drives that are off: it is for somebody who asked for it, never for a poll.
    """
    try:
        require_plan(config, wish)
        cell = connect(config)
    except InvidError as error:
        return Asked(not_ready(config), error, ())
    refusal: InvidError | None = None
    said: tuple[str, ...] = ()
    try:
        said = prepare(cell, config, wish).said
    except InvidError as error:
        refusal = error
    complaints = cell.close()
    said = (*said, *cell.notes, *(w for r in cell.reports for w in r.warnings), *complaints)
    # where the drives did not get to say it, what is remembered stands
    return Asked(cell.not_ready if cell.holdings else not_ready(config), refusal, said)


def known_after_death(config: CellConfig, longest_s: float) -> tuple[str, ...]:
    """What is known of the axes of a run whose processes were killed or died, as sentences; asks no drive.

    A cycle process that is still stopping its drives is waited for, at most so long [s].
    """
    if is_virtual(config):
        return ()
    free = Reservation.await_free(config.bus.interface, config.bus.channel, longest_s)
    said = [f"{r.text}; {r.fix}" for r in remembered(config, _memory(config))]
    if not free:
        said.insert(0, f"the process that drives the axes still has the bus after {longest_s:.0f} s")
    return tuple(said)


def _memory(config: CellConfig) -> HoldMemory:
    return HoldMemory.beside(journal_path(config.bus.interface, config.bus.channel))
