"""The highest frequency that a cycle and a computer's jitter can carry."""

import os
from pathlib import Path

import pytest

from invid.config import load_config
from invid.planning import make_plan
from invid_drivers.timing import Timing, highest_trustworthy, timing_of


def test_without_jitter_a_line_needs_ten_cycles_to_its_period() -> None:
    assert highest_trustworthy(0.001, 0.0) == pytest.approx(100.0)
    assert highest_trustworthy(0.004, 0.0) == pytest.approx(25.0)


def test_a_check_leaves_the_process_with_the_priority_it_had() -> None:
    before = os.sched_getscheduler(0)
    config = load_config(Path(__file__).parents[3] / "configs" / "case-study-unix.yaml")
    found = timing_of(config)
    assert os.sched_getscheduler(0) == before
    assert found.jitter_s is not None
    assert found.highest_hz <= 100.0


def test_a_plan_beyond_what_the_computer_carries_is_told_so() -> None:
    config = load_config(Path(__file__).parents[3] / "configs" / "case-study-unix.yaml")
    plan = make_plan(config)
    assert Timing(0.001, 1e-6, 0.0, True).warnings(plan) == []
    (warning,) = Timing(0.001, 0.004, 0.0, False).warnings(plan)
    # 0.05 rad of jitter at 4 ms: 0.05/(2π·0.004) = 2 Hz
    assert "up to 1.99 Hz" in warning
    assert "bus.cycle_s" in warning
