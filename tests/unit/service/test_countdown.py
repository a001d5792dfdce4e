"""Time left goes down, also between two runs, and promises nothing once it has run out."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from invid_service.jobs.countdown import Countdown
from invid_service.jobs.measurement import MotionProgress


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_an_estimate_that_rises_is_not_told_as_one_and_one_that_falls_is_taken_at_once() -> None:
    clock = Clock()
    countdown, told = Countdown(clock), list[float | None]()
    for clock.now, estimate in ((0.0, 13.0), (1.0, 25.0), (2.0, 24.0), (3.0, 9.0), (4.0, None), (20.0, 30.0)):
        told.append(countdown.left(estimate))
    known = [t for t in told if t is not None]
    assert known == sorted(known, reverse=True)
    assert told[3] == 9.0
    assert told[-1] is None


def test_a_motion_that_stands_between_its_runs_counts_down_and_is_no_further() -> None:
    clock, told = Clock(), list[Any]()
    progress = MotionProgress(lambda p, **_: told.append(p), 3, 40.0, clock=clock)

    def moved(done: float) -> None:
        progress.moved(
            SimpleNamespace(
                eta_s=60.0 - done, fraction=done / 60.0, phase="experiment 1 of 3", axis=None, frequency=None
            )
        )

    for k in range(201):  # twenty seconds of motion, then eighteen in which it is looked at
        clock.now = k / 10
        moved(k / 10)
    before = told[-1]
    for k in range(1, 19):
        clock.now = 20.0 + k
        progress.say()
    lefts = [t.motion_left_s for t in told if t.motion_left_s is not None]
    assert lefts == sorted(lefts, reverse=True)
    assert told[-1].motion_left_s < before.motion_left_s - 8.0
    assert told[-1].place == before.place, "the watchdog sees that nothing moved"
    assert told[-1].eta_s == told[-1].motion_left_s + 40.0
