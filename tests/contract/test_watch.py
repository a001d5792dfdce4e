"""Demand against motion: signs and encoders that change what 0x6077 never shows, told by the statistic.

Whole runs of such drives: `test_foreign_kinds.py`.
"""

from __future__ import annotations

import numpy as np
import pytest

from invid.errors import SafetyStop
from invid.sweep.obedience import ROWS, Obedience
from invid.sweep.ports import Sample

CYCLE = 0.004


class Pushed:
    """A mass on a spring under a random torque; what a drive's encoder shows of it."""

    def __init__(self, seed: int, noise: float = 1e-6, reacts: float = 0.0) -> None:
        self.rng, self.noise, self.reacts = np.random.default_rng(seed), noise, reacts
        self.others = 0.0
        self.x = self.v = 0.0
        self.slot = 0
        self.torque = 0.0
        self.sign, self.stuck, self.friction = 1.0, False, 0.0
        self.shown = 0.0

    def cycle(self) -> tuple[Sample, list[float]]:
        self.torque = 0.97 * self.torque + self.rng.normal()
        self.others = 0.97 * self.others + self.reacts * self.rng.normal()
        if not self.stuck:
            self.shown = self.x + self.noise * self.rng.normal()
        sample = Sample(
            position=[self.shown], torque=[self.torque], status=[0x27], fresh=[True],
            time=self.slot * CYCLE, slot=self.slot,
        )  # fmt: skip
        for _ in range(8):
            h = CYCLE / 8
            force = self.sign * self.torque + self.others - 40.0 * self.x - 0.5 * self.v
            force -= self.friction * np.sign(self.v)
            self.v += h * force
            self.x += h * self.v
        self.slot += 1
        return sample, [self.torque]


def taught(pushed: Pushed, cycles: int = 2000) -> Obedience:
    rows = [pushed.cycle() for _ in range(cycles)]
    obedience = Obedience(["A1"], CYCLE)
    columns = (
        np.array([s.time for s, _ in rows]),
        np.array([u[0] for _, u in rows]),
        np.array([s.position[0] for s, _ in rows]),
        np.ones(cycles, dtype=bool),
    )
    obedience.learn(0, *columns, 10.0)
    return obedience


def cycles_until_stopped(obedience: Obedience, pushed: Pushed, most: int) -> int | None:
    for k in range(most):
        sample, asked = pushed.cycle()
        try:
            obedience.check(sample, asked)
        except SafetyStop:
            return k
    return None


@pytest.mark.campaign
def test_a_healthy_axis_is_left_alone_for_a_thousand_seconds() -> None:
    pushed = Pushed(1)
    assert cycles_until_stopped(taught(pushed), pushed, 250_000) is None


@pytest.mark.parametrize("reacts", [0.5])
def test_a_sign_that_turns_is_told_within_half_a_second_also_where_others_shake_the_axis_as_much(
    reacts: float,
) -> None:
    pushed = Pushed(2, reacts=reacts)
    obedience = taught(pushed)
    assert cycles_until_stopped(obedience, pushed, 1000) is None
    pushed.sign = -1.0
    took = cycles_until_stopped(obedience, pushed, 500)
    assert took is not None
    assert took * CYCLE < 0.52


@pytest.mark.campaign
@pytest.mark.parametrize("others", [3.0, 30.0])
def test_other_axes_and_friction_that_grow_with_the_amplitude_are_no_turned_sign(others: float) -> None:
    for seed in range(10):
        pushed = Pushed(seed, reacts=0.3)
        obedience = taught(pushed)
        pushed.reacts, pushed.friction = others, 1.0
        assert cycles_until_stopped(obedience, pushed, 10_000) is None


def test_a_bump_of_one_block_and_a_pause_of_the_computer_end_nothing() -> None:
    pushed = Pushed(3)
    obedience = taught(pushed)
    for _ in range(50):
        assert cycles_until_stopped(obedience, pushed, 100) is None
        pushed.v += 0.05 * pushed.rng.normal()
    for _ in range(50):
        assert cycles_until_stopped(obedience, pushed, 100) is None
        for _ in range(30):
            pushed.cycle()  # slots that were skipped


def test_an_axis_that_stands_is_not_judged_for_friction_may_hold_it() -> None:
    pushed = Pushed(4)
    obedience = taught(pushed)
    assert cycles_until_stopped(obedience, pushed, 100) is None
    pushed.stuck = True
    assert cycles_until_stopped(obedience, pushed, 10_000) is None


def test_what_was_learned_with_some_axes_shaken_says_nothing_while_others_are() -> None:
    pushed = Pushed(7)
    obedience = taught(pushed)
    pushed.sign = -1.0
    obedience.shake({0})
    assert cycles_until_stopped(obedience, pushed, 2000) is None
    obedience.shake(())
    assert cycles_until_stopped(obedience, pushed, 500) is not None


def test_too_few_rows_teach_nothing_and_a_path_that_is_followed_is_not_judged() -> None:
    pushed = Pushed(5)
    short = taught(pushed, 4 * (ROWS // 2))
    pushed.sign = -1.0
    assert cycles_until_stopped(short, pushed, 2000) is None
    pushed = Pushed(6)
    obedience = taught(pushed)
    obedience.paused = True
    pushed.sign = -1.0
    assert cycles_until_stopped(obedience, pushed, 2000) is None
    obedience.paused = False
    assert cycles_until_stopped(obedience, pushed, 200) is not None
