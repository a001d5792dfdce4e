"""How late this computer wakes, and up to which frequency lines can be trusted with that."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from invid.config import CellConfig
from invid.planning import Plan
from invid.wording.sentence import sentence
from invid_drivers.cia402.cycle import CLOSEST_CYCLES
from invid_drivers.cia402.link import RealClock
from invid_drivers.connect import is_virtual
from invid_drivers.scheduling import priority

PROBE_S = 0.3
PHASE_RAD = 0.05


@dataclass(frozen=True)
class Timing:
    """How well this computer keeps a cycle."""

    cycle_s: float
    jitter_s: float | None
    """Lateness of SYNC (rms) [s]; ``None`` in virtual time, where nobody is late."""
    skipped: float
    """Share of the slots that would have been skipped."""
    realtime: bool
    """Whether the system allows SCHED_FIFO, as it was probed."""

    @property
    def highest_hz(self) -> float:
        """Highest frequency that can be trusted [Hz]."""
        return highest_trustworthy(self.cycle_s, self.jitter_s or 0.0)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "cycle_s": self.cycle_s,
            "jitter_rms_us": None if self.jitter_s is None else self.jitter_s * 1e6,
            "skipped_share": self.skipped,
            "realtime": self.realtime,
            "highest_trustworthy_Hz": self.highest_hz,
        }

    def text(self) -> str:
        """The frequencies that can be trusted and why, as a sentence."""
        cycle = f"a cycle of {self.cycle_s * 1e3:g} ms"
        what = f"frequencies up to {self.highest_hz:.3g} Hz can be trusted at {cycle}"
        if self.jitter_s is None:
            return f"{what} (virtual time)"
        return (
            f"{what} and SYNC {self.jitter_s * 1e6:.0f} µs late (rms, probed now "
            f"{'with' if self.realtime else 'without'} SCHED_FIFO; {self.skipped:.1%} of the slots skipped)"
        )

    def warnings(self, plan: Plan) -> list[str]:
        """A sentence where the plan has lines beyond the frequencies that can be trusted."""
        planned = max(
            (float(e.frequencies_hz.max()) for e in plan.recorded if e.frequencies_hz.size), default=0.0
        )
        if planned <= self.highest_hz:
            return []
        return [
            sentence(
                "lines up to {planned:.3g} Hz are planned, but a cycle of {cycle_s:g} ms and a "
                "computer that sends SYNC {jitter_s:.0f} µs late (rms) carry only those up to "
                "{highest_hz:.3g} Hz; shorten bus.cycle_s, stop other programs, or lower the band",
                planned=planned,
                cycle_s=self.cycle_s * 1e3,
                jitter_s=(self.jitter_s or 0.0) * 1e6,
                highest_hz=self.highest_hz,
            )
        ]


def timing_of(config: CellConfig) -> Timing:
    """Probe this computer at the config's cycle for a moment; opens no bus."""
    cycle = config.bus.cycle_s
    if is_virtual(config):
        return Timing(cycle, None, 0.0, False)
    with priority() as realtime:
        jitter, skipped = wake_jitter(cycle)
    return Timing(cycle, jitter, skipped, realtime)


def wake_jitter(cycle_s: float) -> tuple[float, float]:
    """How late (rms, s) SYNC would be at its slots now, and the share of slots that would be skipped.

    Whoever wakes later than half a cycle sends nothing: such a slot is skipped and no sample is late by it.
    """
    clock = RealClock()
    squares, sent, skipped = 0.0, 0, 0
    slot = clock.now()
    for _ in range(max(20, round(PROBE_S / cycle_s))):
        slot += cycle_s
        clock.sleep_until(slot)
        late = clock.now() - slot
        if late <= CLOSEST_CYCLES * cycle_s:
            squares, sent = squares + late * late, sent + 1
        else:
            skipped += 1 + int(late / cycle_s)
            slot += int(late / cycle_s) * cycle_s
    jitter = math.sqrt(squares / sent) if sent else CLOSEST_CYCLES * cycle_s
    return jitter, skipped / (sent + skipped)


def highest_trustworthy(cycle_s: float, jitter_s: float) -> float:
    """Highest frequency [Hz] with ten cycles to its period and at most 0.05 rad of jitter.

    Ten: the zero-order hold is then 0.3 rad, which is modelled, and its images lie above nine times the
    line. 0.05 rad is one per mille of the torque's power in the wrong phase (0.05²/2).
    """
    by_cycle = 0.1 / cycle_s
    return by_cycle if jitter_s <= 0 else min(by_cycle, PHASE_RAD / (2 * math.pi * jitter_s))
