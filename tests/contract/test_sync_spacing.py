"""SYNC of a computer that is paused at any instruction: slots are skipped, nothing is made up for."""

from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from invid.config import load_config
from invid.sweep import Mode
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.simulated import open_virtual_bus

CONFIG = Path(__file__).parents[2] / "configs" / "case-study.yaml"
MEAN_PAUSE_S = 0.002


class PausedClock:
    """A clock on a computer that the system pauses now and then, whatever it is doing."""

    def __init__(self, clock: Any, seed: int) -> None:
        self._clock, self._rng = clock, np.random.default_rng(seed)
        self.share = 0.0

    def pause(self) -> None:
        if self._rng.random() < self.share:
            self._clock.sleep_until(self._clock.now() + self._rng.exponential(MEAN_PAUSE_S))

    def now(self) -> float:
        self.pause()
        return float(self._clock.now())

    def sleep_until(self, instant: float) -> None:
        self._clock.sleep_until(instant)
        self.pause()


@pytest.mark.parametrize("seed", range(3))
def test_two_syncs_are_never_closer_than_half_a_cycle_wherever_the_computer_was_paused(seed: int) -> None:
    config = load_config(CONFIG)
    bus = open_virtual_bus(config)
    real = bus.clock
    cell = Cia402Cell(bus, config)
    clock = PausedClock(real, seed)
    cell._link.clock = clock
    sent: list[float] = []
    send = bus.send

    def paused_send(msg: can.Message, timeout: float | None = None) -> None:
        clock.pause()
        if msg.arbitration_id == 0x80:
            sent.append(real.now())
        send(msg, timeout)
        clock.pause()

    bus.send = paused_send  # type: ignore[method-assign]
    cell.check()
    cell.energise([Mode.HOLD] * 3)
    assert cell.bounds is not None
    cell.bounds._most_missed = cell.bounds._most_skipped = 10**6  # when SYNC is sent is looked at
    sent.clear()
    clock.share = 0.02
    slots = []
    for _ in range(3000):
        sample = cell.exchange([0.0] * 3)
        slots.append(sample.slot)
    cell.stop()
    gaps = np.diff(sent)
    cycle = config.bus.cycle_s
    assert gaps.min() >= 0.5 * cycle - 1e-9
    assert cell._cycle.skipped_slots > 100  # it was paused indeed
    assert np.diff(slots).min() == 1
    assert np.diff(slots).max() > 2
