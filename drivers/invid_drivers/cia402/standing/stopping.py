"""How a drive stops by itself: its ramp in SI units, and how soon it notices that its master has died."""

from __future__ import annotations

import math
from dataclasses import dataclass

from invid.planning.stopping_distance import StoppingFacts
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.access import Access
from invid_drivers.cia402.limits import distance_to_edge, position_range
from invid_drivers.cia402.objects import Object
from invid_drivers.cia402.stated.scales import Scaling

SLOW_RAMP, BY_LIMIT, SWITCHES_OFF = frozenset({1, 5}), frozenset({3, 4, 7, 8}), frozenset({1, 2})
"""Values of 0x605A: on the ramp of 0x6084; by the current or the voltage limit; else by 0x6085. And those
that end in a drive that gives no torque."""
ATTAINABLE = 0.8
"""Share of torque limit over inertia that a ramp may ask for: a stated inertia is a rough figure, and springs
and the drive's own loop take their part (``bench_stopping.py``)."""
TIMER_CYCLES = 3
"""Cycles beyond those that may be skipped before an RPDO counts as missing."""


@dataclass(frozen=True)
class Ramp:
    """A deceleration as the drive counts it."""

    what: Object
    value: int
    unit: float | None
    """SI value of one; ``None``: nobody says in what it counts."""
    worst: float
    """SI value of one in the unit in which it is slowest."""
    source: str


def read_ramp(drive: Access, scaling: Scaling, option: int) -> Ramp | None:
    """The ramp of a quick stop with that option (0x605A); ``None`` where the drive has no object for it."""
    what = od.PROFILE_DECELERATION if option in SLOW_RAMP else od.QUICK_STOP_DECELERATION
    value = drive.find(what)
    if value is None:
        return None
    counts, rpm = scaling.position_per_count, (1.0 if drive.linear else 2 * math.pi) / 60
    numerator, divisor = drive.find(od.ACCELERATION_NUMERATOR), drive.find(od.ACCELERATION_DIVISOR)
    by = drive.vendor.quick_stop_ramp_unit
    if by == "rpm/s":
        return Ramp(what, value, rpm, rpm, f"{what.address} of {value} rpm/s")
    if numerator and divisor:
        unit = counts * numerator / divisor
        return Ramp(
            what, value, unit, unit, f"{what.address} of {value}, times {numerator}/{divisor} (0x6097)"
        )
    if by == "position units/s²":
        return Ramp(what, value, counts, counts, f"{what.address} of {value} counts/s²")
    slowest = "counts/s²" if counts <= rpm else "rpm/s"
    return Ramp(what, value, None, min(counts, rpm), f"{what.address} of {value}, taken as {slowest}")


@dataclass(frozen=True)
class Stop:
    """How a drive will stop, and what is written for it."""

    deceleration: float | None
    """[rad/s² or m/s²]; ``None``: nobody knows."""
    source: str
    write: tuple[Object, int] | None = None
    lowered: bool = False
    """To what the torque limit allows."""


def stop_of(drive: Access, scaling: Scaling, option: int | None, torque: float) -> Stop:
    """The quick stop with an option (0x605A; ``None``: nobody knows) and a torque limit [N·m or N].

    A deceleration that the config states is believed where the drive's own is not known; where it is, the
    drive is given the config's, if that is more. A ramp that is steeper than the torque limit allows is given
    the deceleration that it allows: a drive that switches off at the end of its ramp would do so before the
    axis stands, and let it coast.
    """
    stated = drive.config.quick_stop_deceleration
    key = f"quick_stop_deceleration_{'m' if drive.linear else 'rad'}_per_s2 of the config"
    if option in BY_LIMIT:
        return Stop(math.inf, f"0x605A is {option}: by its current or voltage limit")
    if option == 0:
        return Stop(None, "0x605A is 0: it coasts")
    ramps = [read_ramp(drive, scaling, o) for o in ((1, 2) if option is None else (option,))]
    if stated is not None and any(r is None or r.unit is None for r in ramps):
        return Stop(stated, key)
    known = [r for r in ramps if r is not None and r.value > 0]
    if len(known) < len(ramps):
        return Stop(None, "0x6085 (quick stop deceleration) is missing or 0")
    slowest = min(known, key=lambda r: r.value * r.worst)
    found = slowest.value * slowest.worst
    wanted, source = (stated, key) if stated is not None and stated > found else (found, slowest.source)
    inertia, capped = drive.config.inertia, drive.vendor.ramp_capped_by_torque_limit.possible
    lowered = False
    if option in SWITCHES_OFF and capped and inertia and not drive.config.gravity_loaded:
        attainable = ATTAINABLE * torque / inertia
        if attainable < wanted:
            unit, lowered = "N" if drive.linear else "N·m", True
            wanted, source = attainable, f"{source}, lowered to what {torque:.3g} {unit} can do"
    if wanted == found:
        return Stop(found, source)
    value = max(1, math.ceil(slowest.value * wanted / found))
    return Stop(wanted, source, (slowest.what, value), lowered)


def event_timer(drive: Access, cycle_s: float, most_skipped: int) -> int | None:
    """0x1400:5 [ms]: longer than any pause that is forgiven, never longer than found; ``None``: not there."""
    found = drive.find(od.RPDO_EVENT_TIMER)
    if found is None:
        return None
    wanted = math.ceil((most_skipped + TIMER_CYCLES) * cycle_s * 1000)
    return min(wanted, 0xFFFF) if found == 0 else min(found, wanted)


def stopping_facts(
    drive: Access,
    scaling: Scaling,
    stop: Stop,
    *,
    stays: bool,
    watch_ms: int | None,
    timer_ms: int | None,
) -> StoppingFacts:
    """What the drive says of its stop.

    Parameters
    ----------
    stays
        Whether it gives torque on when the ramp has ended.
    watch_ms, timer_ms
        0x1016 and 0x1400:5 as they are written; ``None``: the drive does not watch.
    """
    edges = position_range(drive.find(od.POSITION_LIMIT_LOW), drive.find(od.POSITION_LIMIT_HIGH))
    edge = None
    if edges is not None:
        edge = distance_to_edge(drive.read(od.POSITION), *edges) * scaling.position_per_count
    watch_s, watch = _watch(drive, watch_ms, timer_ms)
    return StoppingFacts(
        deceleration=stop.deceleration,
        ramp=stop.source,
        by_torque=stop.lowered,
        stays=stays,
        watch_s=watch_s,
        watch=watch,
        capped=drive.vendor.ramp_capped_by_torque_limit.possible,
        edge=edge,
    )


def _watch(drive: Access, watch_ms: int | None, timer_ms: int | None) -> tuple[float | None, str]:
    """From the death of the master to the quick stop [s], and by what."""
    if watch_ms is None:
        return None, "0x1016 does not watch it"
    if drive.find(od.ABORT_CONNECTION) is None and drive.vendor.heartbeat_lost != "quick stop":
        return None, "0x6007 is missing, and no manual was read that says what it does then"
    if timer_ms is not None and drive.vendor.rpdo_event_timer.certain and timer_ms < watch_ms:
        return timer_ms / 1000, "0x1400:5"
    return watch_ms / 1000, "0x1016"
