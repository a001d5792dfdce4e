"""The highest frequency that a cycle and a computer's jitter can carry."""

import math

import pytest

from invid_drivers.cli.check import highest_trustworthy, wake_jitter


def test_without_jitter_a_line_needs_ten_cycles_to_its_period() -> None:
    assert highest_trustworthy(0.001, 0.0) == pytest.approx(100.0)
    assert highest_trustworthy(0.004, 0.0) == pytest.approx(25.0)


def test_jitter_lowers_it_where_its_phase_matters() -> None:
    highest = highest_trustworthy(0.001, 0.0005)
    assert highest < 100.0
    assert 2 * math.pi * highest * 0.0005 == pytest.approx(0.05)
    assert highest_trustworthy(0.001, 1e-6) == pytest.approx(100.0)


def test_this_computers_jitter_is_a_positive_time() -> None:
    assert 0.0 < wake_jitter(0.001) < 10.0
