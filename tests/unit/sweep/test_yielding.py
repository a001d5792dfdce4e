"""An axis that gets faster against its torque limit is not held by it."""

import numpy as np
import pytest

from invid.errors import SafetyStop
from invid.sweep.ports import Sample
from invid.sweep.stuck_encoder import Yielding

CYCLE = 0.004


def play(speeds: list[float], torques: list[float], *, led: bool = True) -> None:
    watch, place = Yielding(["A1"], [10.0], [2.0], "rad"), 0.0
    for k, (speed, torque) in enumerate(zip(speeds, torques, strict=True)):
        place += CYCLE * speed
        sample = Sample(k, CYCLE * k, [place], [torque], [0x27], [True], [])
        watch.check(sample, {0} if led else set())


def test_an_axis_that_gets_faster_against_all_its_torque_is_stopped() -> None:
    away = list(np.linspace(0.1, 1.0, 20))
    with pytest.raises(SafetyStop, match="A1: gets faster against the torque limit") as stopped:
        play(away, [-10.0] * 20)
    assert stopped.value.code == "yields"
    with pytest.raises(SafetyStop):
        play([-v for v in away], [10.0] * 20)


def test_one_that_slows_down_is_driven_or_has_torque_left_is_not() -> None:
    away = list(np.linspace(0.1, 1.0, 20))
    play(away[::-1], [-10.0] * 20)
    play(away, [10.0] * 20)
    play(away, [-8.0] * 20)
    play(away, [-10.0] * 20, led=False)
