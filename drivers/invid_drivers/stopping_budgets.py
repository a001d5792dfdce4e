"""Plans under the limits that drives leave, and the speeds from which every axis comes to rest in time."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.config import AxisConfig, CellConfig
from invid.config.frames import WATCH_BEATS
from invid.errors import ConfigError, SafetyStop
from invid.model.chains import CoupledChains
from invid.planning import Plan, make_plan
from invid.planning.belief import Belief
from invid.planning.budget import RoundTrip
from invid.planning.forecast import lower_torque
from invid.planning.goal import shortest_runs
from invid.planning.stopping_distance import (
    LEAST_EXCITATION,
    ROUNDING,
    Permitted,
    StoppingBudget,
    StoppingFacts,
    budgets_of,
    permitted,
    torque_shares,
)
from invid.wording.sentence import sentence
from invid_drivers.cia402.axis import DriveReport
from invid_drivers.cia402.limits import tighten, tightened_limits
from invid_drivers.simulated.config import sensor_noise

Budgets = tuple[StoppingBudget, ...]
HALVINGS = 4
"""How finely the speed is sought that the torque needed for it permits: a sixteenth of what is left."""
Measured = Callable[[Sequence[float | None], Sequence[float | None], float], Permitted]
"""Measured inertias, hold torques and the share of the torque that is played to permitted speeds and torque;
SafetyStop where there is none."""


@dataclass(frozen=True)
class Budgeted:
    """A plan, with the config and the budgets under which it may run."""

    plan: Plan
    config: CellConfig
    """With the tightest limits of config, drives and EDS, and the permitted speeds."""
    budgets: Budgets
    said: tuple[str, ...]
    """Which limits are tighter than the config's and why, and what else a person must know, in words."""
    round_trip: RoundTrip | None = None
    """Of the adapter, where it was probed."""


@dataclass(frozen=True)
class Wish:
    """The measurement that is asked for: axes, amplitude, and model or plan."""

    axes: Sequence[str] | None = None
    """Axes to excite; ``None``: as each experiment says."""
    amplitude_scale: float = 1.0
    model: CoupledChains | Belief | None = None
    """The last accepted model."""
    plan: Plan | None = None
    """A plan made before; ``None``: one is made."""


def plan_within(config: CellConfig, reports: Sequence[DriveReport] | None, wish: Wish = Wish()) -> Budgeted:
    """The plan under the effective limits and permitted speeds, or a given plan lowered to them.

    ``reports``: what the drives say; ``None``: they were not asked, and are taken at their best.

    Where the torque that goes on when nobody commands any more would alone take an axis too far, the plan has
    less of it. A lower speed never asks for more torque, so that the budgets made with the plan before it
    hold. It asks for less, and a dead master then leaves the axis less torque to go on with: the speed is
    sought that the torque planned for it permits.

    Raises
    ------
    ConfigError
        The plan cannot be made, and who limits; or an axis cannot come to rest within its room with the least
        excitation.
    """
    if reports is None:
        said: tuple[str, ...] = ()
        tighter, facts = config, [unasked(a, config) for a in config.axes]
    else:
        said = tightened_limits(config, reports)
        tighter = tighten(config, reports)
        facts = [r.stopping for r in reports]
    plan = wish.plan
    if plan is not None:
        require_torque(plan, reports or ())
    experiments = config.experiments
    if plan is None and not experiments and isinstance(wish.model, Belief) and not wish.model.guessed:
        experiments = [shortest_runs(config, wish.model, sensor_noise(config))]

    def made(limits: CellConfig, shares: Sequence[float] | None = None) -> Plan:
        if plan is not None:
            return plan if shares is None else lower_torque(plan, np.asarray(shares))
        try:
            found = make_plan(
                limits.model_copy(update={"experiments": experiments}),
                axes=wish.axes,
                amplitude_scale=wish.amplitude_scale,
                model=wish.model,
                lowered=shares,
            )
            require_torque(found, reports or ())
            return found
        except ConfigError as error:
            raise ConfigError("; ".join([str(error), *said])) from None

    def budgeted(found: Plan) -> Budgets:
        return budgets_of(tighter, facts, found.peak_torque.tolist(), _inertia(config, found))

    first = made(tighter)
    asked = first.peak_torque
    shares = torque_shares(tighter, facts, asked.tolist(), _inertia(config, first))
    if min(shares) < 1.0:
        first = made(tighter, shares)
        # of what the limits had left of it: where they bind less now, a share of what was asked for is more
        over = np.maximum(first.peak_torque / np.maximum(asked * shares, 1e-300), 1.0)
        if over.max() > 1.0 / ROUNDING:
            shares = tuple((shares / over).tolist())
            first = made(tighter, shares)
    budgets = budgeted(first)
    limited = permitted(tighter, budgets)
    found = first if limited is tighter or plan is not None else made(limited, shares)
    if found is not first:
        fast = budgeted(found)
        found, budgets = _fastest(
            found, budgets, fast, lambda b: made(permitted(tighter, b), shares), budgeted
        )
        limited = permitted(tighter, budgets)
    said = (
        *said,
        *lowered_torque(config, shares, found.peak_torque.tolist()),
        *(text for b in budgets for text in b.said(linear=config.linear)),
    )
    return Budgeted(found, limited, budgets, said)


def lowered_torque(config: CellConfig, shares: Sequence[float], peaks: Sequence[float]) -> tuple[str, ...]:
    """Which axes are shaken less than was asked for so that they come to rest, in words."""
    unit = "N" if config.linear else "N·m"
    return tuple(
        sentence(
            "axis {axis}: it is shaken with {share:.0%} of the torque that was asked for, "
            "{peak:.3g} {unit}, so that it comes to rest in its room when nobody commands it "
            "any more (not below {least_excitation:.0%} of the torque limit); what is found is "
            "less certain by as much",
            axis=a.name,
            share=share,
            peak=peak,
            unit=unit,
            least_excitation=LEAST_EXCITATION,
        )
        for a, share, peak in zip(config.axes, shares, peaks, strict=True)
        if share < 1.0
    )


def unasked(axis: AxisConfig, config: CellConfig) -> StoppingFacts:
    """How a drive that nobody has asked is taken to stop: as short as the config allows it to be."""
    stated = axis.quick_stop_deceleration
    watched = not axis.allow_missing_heartbeat
    return StoppingFacts(
        deceleration=math.inf if stated is None else stated,
        ramp="the config's quick_stop_deceleration" if stated else "its torque limit; nobody asked it",
        watch_s=WATCH_BEATS * config.safety.heartbeat_s if watched else None,
        watch="0x1016" if watched else "allow_missing_heartbeat of the config",
        by_torque=stated is None,
    )


def _fastest(
    plan: Plan,
    slow: Budgets,
    fast: Budgets,
    made: Callable[[Budgets], Plan],
    budgeted: Callable[[Plan], Budgets],
) -> tuple[Plan, Budgets]:
    """The plan for the highest speeds that its own torque permits, and the budgets for it.

    Parameters
    ----------
    plan, slow
        A plan whose torque permits more than the speeds that it keeps.
    fast
        What that torque permits.
    """
    low, high, best = 0.0, 1.0, fast
    for _ in range(HALVINGS):
        share = (low + high) / 2
        tried = _between(slow, fast, share)
        candidate = made(tried)
        allowed = budgeted(candidate)
        if all(t.permitted <= a.permitted for t, a in zip(tried, allowed, strict=True)):
            low, plan, best = share, candidate, allowed
        else:
            high = share
    return plan, best


def _between(slow: Budgets, fast: Budgets, share: float) -> Budgets:
    """Budgets whose speeds lie a share of the way from ``slow`` to ``fast``."""
    return tuple(
        replace(f, permitted=s.permitted + share * (f.permitted - s.permitted))
        for s, f in zip(slow, fast, strict=True)
    )


def require_torque(plan: Plan, reports: Sequence[DriveReport]) -> None:
    """ConfigError where an axis is to follow a path whose drive holds it at its place meanwhile."""
    for e in plan.experiments if reports else ():
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
    """Return the function that makes the budgets anew from what the trials measured."""

    facts, peaks = [r.stopping for r in reports], plan.peak_torque

    def permit(inertia: Sequence[float | None], loads: Sequence[float | None], played: float) -> Permitted:
        known = [m or stated for m, stated in zip(inertia, _inertia(config, plan), strict=True)]
        shares = torque_shares(config, facts, peaks.tolist(), known, loads)
        try:
            budgets = budgets_of(config, facts, (played * peaks * shares).tolist(), known, loads)
        except ConfigError as error:
            raise SafetyStop(f"by what the trials measured: {error.reason}", way_out=error.way_out) from None
        return Permitted(permitted(config, budgets), shares)

    return permit
