"""Limits only tighten: what stands in a drive, what the config and the EDS say, and the tightest of them.

Everything here is pure. Values are those of the drive's objects where nothing else is said.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from invid.config import CellConfig
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.objects import Object

if TYPE_CHECKING:
    from invid_drivers.cia402.axis import DriveReport

STOPPING = {
    od.QUICK_STOP_OPTION: frozenset({1, 2, 3, 4, 5, 6, 7, 8}),
    od.ABORT_CONNECTION: frozenset({1, 2, 3}),
}
"""Values of an option that end in a stop (CiA 402-2): 0x605A 0 lets the axis coast, 0x6007 0 does nothing."""
ZERO_IS_OFF = frozenset({od.PRODUCER_HEARTBEAT})
"""Times of which 0 means never. 0x6066 is not among them: there 0 means at once, the tightest of all."""


def tighter(what: Object, found: int, wanted: int) -> int:
    """The tighter of what stands in the drive and what is wanted there; never more permissive than found.

    "Off" is the type's highest value (0xFFFFFFFF in 0x607F and 0x6065) and so never the tighter one. A pair
    0x607D that is off, and a torque limit that is 0, are for the caller: see ``position_range``.
    """
    stopping = STOPPING.get(what)
    if stopping is not None:
        return wanted if wanted in stopping or found not in stopping else found
    if what in ZERO_IS_OFF and found == 0:
        return wanted
    return max(found, wanted) if what is od.POSITION_LIMIT_LOW else min(found, wanted)


def position_range(low: int | None, high: int | None) -> tuple[int, int] | None:
    """0x607D as (low, high); ``None`` where it is off (both 0) or missing."""
    if low is None or high is None or low == high == 0:
        return None
    return low, high


def tighter_watch(found: int, master: int, watch_ms: int) -> int:
    """An entry of 0x1016 that watches ``master`` at most so long; one that stands there may be shorter."""
    node, ms = watched(found)
    return master << 16 | (min(ms, watch_ms) if node == master and ms > 0 else watch_ms)


def watched(entry: int) -> tuple[int, int]:
    """Node and time [ms] of an entry of 0x1016; an entry of no time watches nobody."""
    return entry >> 16 & 0x7F, entry & 0xFFFF


@dataclass(frozen=True)
class Limit:
    """A limit of one axis and who says it."""

    value: float
    """[N·m, rad, rad/s; N, m, m/s]"""
    source: str


def tightest(first: Limit, others: Sequence[Limit]) -> Limit:
    """The smallest; of equal ones the first, which is the config's."""
    return min((first, *others), key=lambda limit: limit.value)


@dataclass(frozen=True)
class EffectiveLimits:
    """The tightest of drive, config and EDS for one axis."""

    torque: Limit
    position: Limit
    """Distance from where the axis stands, the smaller of both sides."""
    velocity: Limit


def distance_to_edge(here: int, low: int, high: int) -> int:
    """Counts from ``here`` to the nearer edge of 0x607D; negative outside of it."""
    return min(here - low, high - here)


def counts_of_window(limit: float, margin: float, position_per_count: float) -> int:
    """A window with its margin [rad or m] in whole counts, at least one."""
    return max(1, math.ceil(margin * limit / position_per_count))


def tighten(config: CellConfig, reports: Sequence[DriveReport]) -> CellConfig:
    """The config with the effective limits of its drives; the config itself where it has the tightest."""
    found = {r.axis: r.limits for r in reports}
    axes = []
    for axis in config.axes:
        limits = found[axis.name]
        values = {
            "torque": min(axis.limits.torque, limits.torque.value),
            "position": min(axis.limits.position, limits.position.value),
            "velocity": min(axis.limits.velocity, limits.velocity.value),
        }
        axes.append(axis.model_copy(update={"limits": axis.limits.model_copy(update=values)}))
    return config if axes == config.axes else config.model_copy(update={"axes": axes})


def tightened_limits(config: CellConfig, reports: Sequence[DriveReport]) -> tuple[str, ...]:
    """Which limits are tighter than the config's, by whom, in words; of a torque that no drive gives, the way
    out."""
    found = {r.axis: r.limits for r in reports}
    length, torque = ("m", "N") if config.linear else ("rad", "N·m")
    said = []
    for axis in config.axes:
        limits = found[axis.name]
        for what, limit, configured, unit in (
            ("torque", limits.torque, axis.limits.torque, torque),
            ("position window", limits.position, axis.limits.position, f"{length} to each side"),
            ("velocity", limits.velocity, axis.limits.velocity, f"{length}/s"),
        ):
            if limit.value < configured:
                said.append(
                    f"axis {axis.name}: the {what} is limited to {limit.value:.4g} {unit}, not to the "
                    f"config's {configured:g}: {limit.source}"
                    + ("; correct the config's limit, or its unit" if what == "torque" else "")
                )
    return tuple(said)
