"""Bus budget: how much of the bus a cycle takes in the worst case, what that allows, and what an adapter
carries.

A share of round trips is bounded without assuming how they are distributed: of n samples in order, the one
of rank r lies above the quantile q with probability P(Bin(n, q) < r). The smallest r that makes this 95 %
is taken: for q = 0.99 the largest of 299 samples, the second largest of 600, the 13th largest of 2000.
Fewer than 299 do not bound it; the largest is then taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from invid.config import CellConfig
from invid.config.frames import LONGEST_HEARTBEAT_S, cycle_bits, frame_bits
from invid.errors import ConfigError
from invid.numerics.distributions import binomial_isf


def bus_load(drives: int, *, cycle_s: float, bitrate: int, heartbeat_s: float = LONGEST_HEARTBEAT_S) -> float:
    """Share of the bus that cycle and heartbeats (master and drives) take in the worst case."""
    heartbeats = (drives + 1) * frame_bits(1) / heartbeat_s
    return (cycle_bits(drives) / cycle_s + heartbeats) / bitrate


@dataclass(frozen=True)
class BusBudget:
    """Load of the cell's bus and the shortest cycle that it would carry."""

    load: float
    max_load: float
    shortest_cycle_s: float

    @property
    def fits(self) -> bool:
        """Return whether the load is allowed."""
        return self.load <= self.max_load


def bus_budget(config: CellConfig) -> BusBudget:
    """The budget of a cell."""
    bus, drives, beat = config.bus, len(config.axes), config.safety.heartbeat_s
    load = bus_load(drives, cycle_s=bus.cycle_s, bitrate=bus.bitrate_bit_per_s, heartbeat_s=beat)
    free = bus.max_load * bus.bitrate_bit_per_s - (drives + 1) * frame_bits(1) / beat
    shortest = cycle_bits(drives) / free if free > 0 else float("inf")
    return BusBudget(load, bus.max_load, shortest)


def require_budget(config: CellConfig) -> BusBudget:
    """The budget; ConfigError where the bus would be over it."""
    budget = bus_budget(config)
    if not budget.fits:
        bus = config.bus
        raise ConfigError(
            f"bus: {len(config.axes)} drives every {bus.cycle_s * 1e3:g} ms load a bus of "
            f"{bus.bitrate_bit_per_s / 1e3:g} kbit/s to {budget.load:.0%} in the worst case, more than "
            f"max_load {budget.max_load:.0%}; set cycle_s to {next_cycle(budget.shortest_cycle_s):g} or "
            "longer"
        )
    return budget


def next_cycle(seconds: float) -> float:
    """The next cycle time that a drive is likely to take."""
    for step in (0.0005, 0.001, 0.002, 0.004, 0.005, 0.008, 0.01, 0.02, 0.05, 0.1):
        if step >= seconds:
            return step
    return seconds


CONFIDENCE = 0.95
"""That the bound of a share is above it."""
SHARE = 0.99
"""Of the round trips that the proposed cycle is to hold."""
RUN_RISK = 0.01
"""Of ending a run because ``missed_tpdos`` answers in a row came late, were each late by itself. What makes
several late at once is the computer, which the config's ``missed_tpdos`` is there to forgive."""
ANSWER_SHARE = 0.85
"""Of a cycle in which the drives' answers are waited for (``invid_drivers.cia402.cycle``)."""
SDO_BYTES = 8


SLOW_SDO_S = 0.1
"""No adapter takes so long (a USB latency timer: 16 ms), and no config may state more."""


@dataclass(frozen=True)
class RoundTrip:
    """Round trip of an adapter as it was probed, and what it means for the config's cycle.

    Attributes
    ----------
    count
        Round trips of the node that answered fastest.
    median_s, bound_s, worst_s
        Of these, ``bound_s`` is above 99 % of all with 95 % confidence (the worst one, where fewer than 299
        came) [s].
    late_share
        Of the cycles whose answers would have come too late.
    shortest_cycle_s
        The shortest usual cycle that adapter, bus load and number of drives carry.
    cycle_s, carries
        The config's cycle, and whether it is carried.
    """

    count: int
    median_s: float
    bound_s: float
    worst_s: float
    late_share: float
    shortest_cycle_s: float
    cycle_s: float
    carries: bool

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "count": self.count,
            "median_ms": self.median_s * 1e3,
            "bound_ms": self.bound_s * 1e3,
            "bound_share": SHARE,
            "bound_confidence": CONFIDENCE,
            "worst_ms": self.worst_s * 1e3,
            "late_share": self.late_share,
            "shortest_cycle_s": self.shortest_cycle_s,
            "carries": self.carries,
        }

    @property
    def is_of_drives(self) -> bool:
        """Whether it is the drives that are slow to answer SDO, so that nothing is known of the adapter."""
        return self.median_s > SLOW_SDO_S

    @property
    def text(self) -> str:
        """Return the budget in a sentence."""
        if self.is_of_drives:
            return (
                f"the drives are slow to answer SDO: {self.median_s:.2g} s in the median of {self.count} "
                "reads, which no adapter takes; its own round trip cannot be told from that"
            )
        return (
            f"the adapter's round trip is {self.median_s * 1e3:.2g} ms, 99 % within "
            f"{self.bound_s * 1e3:.2g} ms ({self.count} SDO reads, 95 % confidence): it carries cycles from "
            f"{self.shortest_cycle_s * 1e3:g} ms"
        )

    @property
    def doubt(self) -> str:
        """What is open where a round trip would not carry the config's cycle."""
        if self.is_of_drives:
            return f"bus: {self.text}. Their answers to SYNC tell, before any drive is enabled"
        return (
            f"bus: an SDO read takes {self.median_s * 1e3:.2g} ms, longer than cycle_s of "
            f"{self.cycle_s * 1e3:g} ms lets answers take: the adapter or the drives' own time for SDO. "
            "Their answers to SYNC tell, before any drive is enabled"
        )

    @property
    def refusal(self) -> str:
        """What the config's cycle would meet if it were the adapter, and the way out."""
        return (
            f"bus: cycle_s is {self.cycle_s:g}, but {self.text}; at {self.cycle_s * 1e3:g} ms "
            f"{self.late_share:.0%} of the answers would come too late. Set bus.cycle_s to "
            f"{self.shortest_cycle_s:g} or longer. Where the drives are slow to answer SDO and the adapter "
            "is known to be faster, state its round trip in bus.round_trip_s"
        )


def rank(count: int, share: float) -> int | None:
    """Rank (from 1) of the sample that bounds a share from above; ``None`` where the count is too small."""
    found = binomial_isf(1.0 - CONFIDENCE, count, share) + 1
    return found if found <= count else None


def bound(samples: Sequence[float], share: float) -> float:
    """Upper bound of a share of what was sampled; the largest sample where there are too few for one."""
    ordered = np.sort(np.asarray(samples, dtype=float))
    found = rank(ordered.size, share)
    return float(ordered[-1 if found is None else found - 1])


def tolerable_share(cycles: int, missed: int) -> float:
    """Share of late cycles with which ``missed`` in a row happen in a run with probability ``RUN_RISK``."""
    return float((RUN_RISK / max(cycles, 1)) ** (1.0 / missed))


def needed(round_trip_s: float, drives: int, bitrate: int) -> float:
    """Cycle that one round trip of SDO (two frames) asks for with the frames of all drives [s].

    What the adapter and the computer take is in the round trip; the wire is not the same for a cycle.
    """
    wire = (cycle_bits(drives) - 2 * frame_bits(SDO_BYTES)) / bitrate
    return (max(round_trip_s + wire, 0.0)) / ANSWER_SHARE


def shortest_cycle(round_trip_s: float, drives: int, bitrate: int, loaded_s: float) -> float:
    """The shortest usual cycle that the adapter and (``loaded_s``) the bus load carry [s]."""
    return next_cycle(max(needed(round_trip_s, drives, bitrate), loaded_s))


def judge(samples: Sequence[float], config: CellConfig, *, cycles: int, loaded_s: float) -> RoundTrip:
    """Judge the config's cycle by the samples [s], over a run of so many cycles.

    Refused is what may end the run: more late answers than its ``missed_tpdos`` forgives. Proposed is what
    holds 99 % of the round trips.
    """
    bus, drives = config.bus, len(config.axes)
    usual, worst = bound(samples, SHARE), max(samples)
    must = bound(samples, 1.0 - tolerable_share(cycles, config.safety.missed_tpdos))
    if bus.round_trip_s is not None:
        usual = must = bus.round_trip_s
    ask = [needed(s, drives, bus.bitrate_bit_per_s) for s in samples]
    return RoundTrip(
        count=len(samples),
        median_s=float(np.median(samples)),
        bound_s=bound(samples, SHARE),
        worst_s=worst,
        late_share=float(np.mean(np.asarray(ask) > bus.cycle_s)),
        shortest_cycle_s=shortest_cycle(max(usual, must), drives, bus.bitrate_bit_per_s, loaded_s),
        cycle_s=bus.cycle_s,
        carries=needed(must, drives, bus.bitrate_bit_per_s) <= bus.cycle_s,
    )
