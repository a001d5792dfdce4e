"""Whether a cell may be measured, and with what plan: one answer for check, dry run, run and service."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from invid.config import CellConfig
from invid.errors import DriveError, InvidError, note_left
from invid.planning import make_plan
from invid.planning.budget import tolerable_share
from invid.planning.forecast import fit_to_limits
from invid.planning.hold_laws import master_hold
from invid.wording.sentence import sentence
from invid_drivers.cia402.axis import DriveReport
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.journal import journal_path
from invid_drivers.cia402.reservation import Reservation
from invid_drivers.cia402.standing.hold_memory import HoldMemory
from invid_drivers.cia402.standing.holding import AxisHolding, Reason, remembered, to_support
from invid_drivers.connect import connect, is_virtual
from invid_drivers.round_trip import probe, require
from invid_drivers.stopping_budgets import Budgeted, Wish, plan_within


def prepare(
    cell: Cia402Cell,
    config: CellConfig,
    wish: Wish = Wish(),
    *,
    probes: bool | None = None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Budgeted:
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
    return replace(found, plan=plan, said=said, round_trip=trip)


def require_plan(config: CellConfig, wish: Wish) -> None:
    """ConfigError for what no drive could change: before a bus is opened, or a process started."""
    for axis in config.axes:
        master_hold(axis, config.bus.cycle_s)
    if wish.plan is None:
        make_plan(config, axes=wish.axes, amplitude_scale=wish.amplitude_scale, model=wish.model)


def foresee(config: CellConfig, wish: Wish = Wish()) -> Budgeted:
    """Do as ``prepare``, but touch no bus that hardware may be on: its drives are taken at their best.

    Raises
    ------
    ConfigError, DriveError
        What ``prepare`` would refuse whatever the drives say; in virtual time, what it refuses.
    """
    require_plan(config, wish)
    if is_virtual(config):
        cell = connect(config)
        try:
            return prepare(cell, config, wish)
        finally:
            cell.close()
    return plan_within(config, None, wish)


def loads_to_support(config: CellConfig) -> tuple[str, ...]:
    """Axes whose hold after a stop the next measurement tries: what they carry must not be able to fall far.

    None where no hardware stands behind the config.
    """
    return () if config.simulated else to_support(config, _memory(config))


def support_sentence(axes: Sequence[str]) -> str:
    """What a person does about these axes before anything moves."""
    return sentence(
        "how {names} is held after a stop was not seen yet; where it carries a load, that "
        "is tried first, at rest. Support it so that it cannot fall far and still hangs on "
        "its drive",
        names=", ".join(axes),
    )


def not_ready(config: CellConfig) -> tuple[Reason, ...]:
    """Reasons of axes that an earlier run left energised, or at which it ended, as of when that was seen.

    Nothing is asked or sent: what the drives say now is for ``invid check``, which writes to them.
    """
    return () if is_virtual(config) else remembered(config, _memory(config))


@dataclass(frozen=True)
class Asked:
    """What the drives of a cell said when they were asked: the one answer to whether it may be measured."""

    reasons: tuple[Reason, ...]
    """Axes that are energised though nobody measures, or at which a run ended."""
    refusal: InvidError | None
    """The first thing that keeps a measurement from starting."""
    said: tuple[str, ...]
    """What is to be known beside: of drives, bus, limits and adapter."""
    prepared: Budgeted | None = None
    reports: tuple[DriveReport, ...] = ()
    holdings: tuple[AxisHolding, ...] = ()

    def __post_init__(self) -> None:
        if self.refusal is not None:  # whoever is refused hears of what is under power, too
            note_left(self.refusal, (s for r in self.reasons for s in r.sentences))

    @property
    def can_start(self) -> bool:
        """Whether a measurement can start; an axis that it takes over without letting go does not matter."""
        return self.refusal is None and all(r.taken_over for r in self.reasons)

    def require(self) -> Budgeted:
        """Return what was prepared; else raise the refusal, or DriveError for an axis that is not ready."""
        if self.refusal is not None:
            raise self.refusal
        for reason in self.reasons:
            if not reason.taken_over:
                raise DriveError(f"{reason.text}; {reason.fix}", axis=reason.axis)
        if self.prepared is None:
            raise DriveError("the drives were not asked")
        return self.prepared


def ask(
    config: CellConfig, wish: Wish = Wish(), *, cleared: Sequence[str] = (), probes: bool | None = None
) -> Asked:
    """Ask the drives whether a measurement can start, and restore what an earlier run left in them.

    This writes to drives that are off: it is for somebody who asked for it, never for a poll. ``cleared``:
    axes at which an earlier run ended and of which a person has found the cause; ``probes``: see ``prepare``.
    """
    try:
        require_plan(config, wish)
        cell = connect(config)
    except InvidError as error:
        return Asked(not_ready(config), error, ())
    refusal, prepared = None, None
    try:
        cell.held.clear(cleared)
        prepared = prepare(cell, config, wish, probes=probes)
    except InvidError as error:
        refusal = error
    finally:
        complaints = cell.close()
    said = () if prepared is None else prepared.said
    said = (*complaints, *cell.notes, *said, *(w for r in cell.reports for w in r.warnings))
    # where the drives did not get to say it, what is remembered stands
    reasons = cell.held.not_ready if cell.held.holdings else not_ready(config)
    return Asked(reasons, refusal, said, prepared, tuple(cell.reports), tuple(cell.held.holdings))


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
