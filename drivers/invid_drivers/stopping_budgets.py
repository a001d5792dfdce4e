"""Plans under the limits that drives leave, and the speeds from which every axis comes to rest in time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from invid.config import CellConfig
from invid.errors import ConfigError, SafetyStop
from invid.model.chains import CoupledChains
from invid.planning import Plan, make_plan
from invid.planning.belief import Belief
from invid.planning.stopping_distance import StoppingBudget, budgets_of, permitted, planned_torque
from invid_drivers.cia402.axis import DriveReport
from invid_drivers.cia402.limits import tighten, tightened_limits

Measured = Callable[[Sequence[float | None], Sequence[float | None]], CellConfig]
"""Measured inertias and hold torques to the config with permitted speeds; SafetyStop where one is none."""


@dataclass(frozen=True)
class Budgeted:
    """A plan and what it stands on."""

    plan: Plan
    config: CellConfig
    """With the tightest limits of config, drives and EDS, and the permitted speeds."""
    budgets: tuple[StoppingBudget, ...]
    said: tuple[str, ...]
    """Which limits are tighter than the config's and why, in words."""


def plan_within(
    config: CellConfig,
    reports: Sequence[DriveReport],
    *,
    axes: Sequence[str] | None = None,
    amplitude_scale: float = 1.0,
    model: CoupledChains | Belief | None = None,
    plan: Plan | None = None,
) -> Budgeted:
    """The plan under the effective limits and permitted speeds, or those of a given plan.

    A lower speed never asks for more torque, so that the budgets made with the plan before it hold.

    Raises
    ------
    ConfigError
        The plan cannot be made, and who limits; or an axis cannot come to rest within its room.
    """
    tighter = tighten(config, reports)
    if plan is not None:
        require_torque(plan, reports)
    said = tightened_limits(config, reports)

    def made(limits: CellConfig) -> Plan:
        if plan is not None:
            return plan
        try:
            found = make_plan(limits, axes=axes, amplitude_scale=amplitude_scale, model=model)
            require_torque(found, reports)
            return found
        except ConfigError as error:
            raise ConfigError("; ".join([str(error), *said])) from None

    first = made(tighter)
    budgets = budgets_of(
        tighter, [r.stopping for r in reports], planned_torque(first), _inertia(config, first)
    )
    said = (*said, *(text for b in budgets for text in b.said(linear=config.linear)))
    limited = permitted(tighter, budgets)
    return Budgeted(first if limited is tighter else made(limited), limited, budgets, said)


def require_torque(plan: Plan, reports: Sequence[DriveReport]) -> None:
    """ConfigError where an axis is to follow a path whose drive holds it at its place meanwhile."""
    for e in plan.experiments:
        led = [reports[i].axis for i in e.excited if reports[i].by_offset and e.reference is not None]
        if led:
            raise ConfigError(
                f"experiment {e.key} ({e.kind}) leads axis {', '.join(led)} along a path, but its drive "
                "holds it at its place and takes a torque offset only; leave constant velocities and "
                "creep to axes with cyclic synchronous torque"
            )


def _inertia(config: CellConfig, plan: Plan) -> list[float | None]:
    return list(plan.inertia) if plan.inertia else [a.inertia for a in config.axes]


def measured_budgets(config: CellConfig, reports: Sequence[DriveReport], plan: Plan) -> Measured:
    """The budgets anew, when trials have measured what was stated."""

    def permit(inertia: Sequence[float | None], loads: Sequence[float | None]) -> CellConfig:
        known = [m or stated for m, stated in zip(inertia, _inertia(config, plan), strict=True)]
        try:
            budgets = budgets_of(config, [r.stopping for r in reports], planned_torque(plan), known, loads)
        except ConfigError as error:
            raise SafetyStop(f"by what the trials measured: {error}") from None
        return permitted(config, budgets)

    return permit
