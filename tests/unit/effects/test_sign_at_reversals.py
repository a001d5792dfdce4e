"""Dry friction turns round while the motor does, and bends its velocity there."""

from __future__ import annotations

import numpy as np
import pytest

from invid.effects.laws.sign import excess_law, sign_law


@pytest.mark.parametrize("up", [1.0, -1.0])
def test_zero_comes_earlier_where_friction_bends_the_velocity(up: float) -> None:
    """Up to 0.7 of the interval it gains 1 an interval, then 0.6: its ends are −0.7 and 0.18."""
    v = up * np.array([-2.0, -1.7, -0.7, 0.18, 0.78, 1.4])
    straight, bent = (sign_law(v, 1e-9, turn)[2:4] for turn in (0.0, 0.4))
    mean = 0.3 - 0.7
    assert bent == pytest.approx(up * np.array([0.5 * (mean - 1.0), 0.5 * (mean + 1.0)]), abs=1e-6)
    assert np.all(up * straight < up * bent)
    assert excess_law(v, 1e-9, 1e6, 0.4)[2:4] == pytest.approx(bent, abs=1e-4)


def test_a_velocity_that_does_not_turn_round_feels_nothing_of_it() -> None:
    v = 2.0 + np.cos(np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False))
    assert np.array_equal(sign_law(v, 1e-6, 0.4), sign_law(v, 1e-6))


def test_an_excess_of_friction_is_over_before_the_interval_is() -> None:
    """The velocity of the test above, and a Stribeck effect gone at a fifth of it."""
    v = np.array([-2.0, -1.7, -0.7, 0.18, 0.78, 1.4])
    time = np.linspace(0.0, 1.0, 200_001)
    path = np.where(time < 0.7, time - 0.7, 0.6 * (time - 0.7))
    turning = np.mean(np.sign(path) * np.exp(-((path / 0.1) ** 2)))
    plain = np.linspace(-1.7, -0.7, 200_001)
    before = -np.mean(np.exp(-((plain / 0.1) ** 2)))
    assert excess_law(v, 1e-9, 0.1, 0.4)[2] == pytest.approx(0.5 * (before + turning), abs=1e-4)
