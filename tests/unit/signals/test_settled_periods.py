"""Which periods are used: a machine that changed has not settled."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Complex128
from invid.signals.periods import Settling, find_settled_periods

LINES, FLOOR = 60, np.array([1e-4])


def _periods(*shapes: float) -> Complex128:
    """Periods that are off the last by some size, with noise."""
    rng = np.random.default_rng(1)
    off = rng.standard_normal((LINES, 1)) + 1j * rng.standard_normal((LINES, 1))
    noise = rng.standard_normal((2, len(shapes), LINES, 1)) * np.sqrt(FLOOR / 2)
    out: Complex128 = np.array(shapes)[:, None, None] * off + noise[0] + 1j * noise[1]
    return out


def test_periods_that_come_nearer_are_a_transient_and_left_out() -> None:
    assert find_settled_periods(_periods(1.0, 0.3, 0.09, 0.0, 0.0, 0.0), FLOOR, 1e4) == Settling(3, True)


def test_periods_alike_before_others_are_a_machine_that_changed() -> None:
    assert find_settled_periods(_periods(1.0, 1.0, 0.4, 0.0, 0.0, 0.0), FLOOR, 1e4) == Settling(0, True)


def test_what_drifts_between_the_excited_lines_costs_no_period() -> None:
    """Of fourteen periods two were used: the low lines that nothing excites wander."""
    rng = np.random.default_rng(7)
    periods = _periods(0.3, *[0.0] * 13)
    excited = np.arange(LINES) % 2 == 1
    wander = 0.1 * np.cumsum(rng.standard_normal((14, 8)) + 1j * rng.standard_normal((14, 8)), axis=0)
    periods[:, 0:16:2, 0] += wander * (14.0 - np.arange(14)[:, None])
    assert find_settled_periods(periods, FLOOR, 1e4, excited).first == 1
    assert find_settled_periods(periods, FLOOR, 1e4).first > 6
