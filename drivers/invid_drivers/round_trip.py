"""How long an adapter takes for a frame out and one back, probed with SDO reads of 0x1000.

Nobody is disturbed: only nodes of the config are asked, one read at a time each, at the rate of the cycle and
at an identifier below every PDO. All nodes are asked at once, as in a cycle; the fastest of them tells about
the adapter, the others' own time for SDO is not the adapter's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from invid.config import CellConfig
from invid.errors import BusError
from invid.planning import Plan
from invid.planning.budget import SHARE, RoundTrip, bound, judge
from invid.wording.sentence import sentence
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.link import Link
from invid_drivers.scheduling import priority

COUNT = 2000
"""Rounds: 99 % are then bounded by the 13th largest, which a few pauses of the computer do not move."""
LONGEST_S = 3.0
"""Of the probe; an adapter of 5 ms gets its 600 rounds in, and 99 % are bounded by the second largest."""
PATIENCE_S = 1.0
"""A node that has not answered by then is not asked again."""

_READ = bytes((0x40, od.DEVICE_TYPE.index & 0xFF, od.DEVICE_TYPE.index >> 8, 0, 0, 0, 0, 0))


def sample(
    link: Link,
    nodes: Sequence[int],
    *,
    every_s: float,
    count: int = COUNT,
    longest_s: float = LONGEST_S,
    cancelled: Callable[[], bool] = lambda: False,
) -> list[float]:
    """Round trips [s] of the node that answers fastest, in the order they were taken.

    ``cancelled`` ends it with what there is after the first round.

    Raises
    ------
    BusError
        No node answers.
    """
    clock = link.clock
    took: dict[int, list[float]] = {n: [] for n in nodes}
    asked = list(nodes)
    end = clock.now() + longest_s
    with priority():
        for _ in range(count):
            begun = clock.now()
            if begun >= end or not asked or (any(took.values()) and cancelled()):
                break
            waiting = set(asked)
            for node in asked:
                link.send(0x600 + node, _READ)
            while waiting and (rest := begun + PATIENCE_S - clock.now()) > 0:
                message = link.get(rest)
                if message is None:
                    continue
                node = message.arbitration_id - 0x580
                if node in waiting and not message.is_extended_id and not message.is_error_frame:
                    took[node].append(clock.now() - begun)
                    waiting.discard(node)
                link.sort(message)
            asked = [n for n in asked if n not in waiting]
            clock.sleep_until(begun + every_s)
    answered = [t for t in took.values() if t]
    if not answered:
        raise BusError(
            sentence(
                "bus {channel_info}: no node answers SDO; check power, cable, termination and bit rate",
                channel_info=link.bus.channel_info,
            )
        )
    fullest = max(len(t) for t in answered)
    return min((t for t in answered if len(t) == fullest), key=lambda t: bound(t, SHARE))


def probe(
    link: Link, config: CellConfig, plan: Plan, cancelled: Callable[[], bool] = lambda: False
) -> RoundTrip:
    """The adapter's round trip and what it means for the config's cycle."""
    nodes = [a.node_id for a in config.axes]
    samples = sample(link, nodes, every_s=config.bus.cycle_s, cancelled=cancelled)
    cycles = sum(e.cycles for e in plan.experiments)
    return judge(samples, config, cycles=cycles, loaded_s=plan.budget.shortest_cycle_s)


def require(found: RoundTrip, config: CellConfig) -> list[str]:
    """Return what to say of a round trip.

    One that would not carry the config's cycle may be the drives' own time for SDO: that is told by their
    answers to SYNC, before power (``Cia402Cell.expect_answers``).
    """
    if found.carries and found.is_of_drives:
        return [f"{found.text}; bus.round_trip_s counts"]
    if found.carries:
        late = found.late_share
        return [f"{late:.1%} of the cycles' answers would come too late: {found.text}"] * (late > 1 - SHARE)
    return [found.refusal if config.simulated else found.doubt]
