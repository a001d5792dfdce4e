"""A fall is told from rest by counts of the encoder: how soon, and how seldom without one."""

import math

import numpy as np
import pytest

from invid.errors import SafetyStop
from invid.sweep.axis_estimator import (
    LEARN_SAMPLES,
    STAND_S,
    AxisEstimator,
    AxisLimits,
    Fall,
    Kind,
    window_of,
)
from invid.sweep.bounds import Bounds
from invid.sweep.ports import Sample

CYCLE, COUNT, RATED, WINDOW = 0.002, 2 * math.pi / 2**16, 10.0, 0.5


def looked_at(
    x: np.ndarray, torque: np.ndarray, count: float = COUNT, cycle: float = CYCLE
) -> dict[float, Fall]:
    """Falls by the time at which they were seen; positions are rounded to counts."""
    watch = AxisEstimator(AxisLimits("A1", 2 * RATED, WINDOW, 5.0, count, RATED, "rad", "N·m"), cycle)
    found = {}
    for k, (place, shown) in enumerate(zip(np.round(x / count) * count, torque, strict=True)):
        watch.take(k * cycle, float(place), float(shown), quiet=True)
        if watch.fall is not None:
            found[k * cycle] = watch.fall
    return found


def test_an_axis_that_stands_is_never_called_falling_whatever_its_counts_and_its_torque_do() -> None:
    rng = np.random.default_rng(1)
    n = 200_000
    for count in (COUNT, 16 * COUNT, COUNT / 16):
        rest = count * (0.5 + 0.7 * rng.normal(size=n))
        assert looked_at(rest, 8.0 + 0.05 * rng.normal(size=n), count) == {}


@pytest.mark.parametrize("hz", [2.0, 5.0, 20.0])
@pytest.mark.parametrize("load", [0.5, 2.0, 5.0])
def test_a_loop_that_sags_under_a_load_that_comes_suddenly_is_not_called_falling(
    hz: float, load: float
) -> None:
    w = 2 * math.pi * hz
    t = CYCLE * np.arange(2000) - 1.0
    sag = np.where(t > 0, load / w**2 * (1 - np.exp(-0.3 * w * t) * np.cos(w * t)), 0.0)
    assert looked_at(-sag, w**2 * sag) == {}


@pytest.mark.parametrize("hz", [0.5, 3.0, 15.0])
def test_a_held_axis_that_others_shake_is_not_called_falling(hz: float) -> None:
    t = CYCLE * np.arange(10_000)
    x = 0.01 * np.minimum(1.0, t) * np.sin(2 * math.pi * hz * t)
    assert looked_at(x, 8.0 - 400.0 * x) == {}


@pytest.mark.parametrize("acceleration", [1.0, 3.0, 10.0])
@pytest.mark.parametrize("shown", [0.0, 5.0])
def test_a_fall_is_seen_within_three_milliradians_and_not_taken_for_a_wrong_sign(
    acceleration: float, shown: float
) -> None:
    t = CYCLE * np.arange(1000) - 1.0
    found = looked_at(-0.5 * acceleration * np.maximum(t, 0.0) ** 2, np.full(1000, shown))
    first = min(found)
    assert 0.5 * acceleration * (first - 1.0) ** 2 < 0.004
    assert found[first].kind is Kind.FALLS
    assert found[first].torque == pytest.approx(shown, abs=1e-9)
    assert not found[first].at_limit
    steady = [f.acceleration for at, f in found.items() if at > first + 0.1]
    assert np.mean(steady) == pytest.approx(acceleration, rel=0.02)


@pytest.mark.parametrize("left", [0.0, 5.0])
def test_a_load_whose_torque_ceases_is_seen_before_one_that_never_had_any(left: float) -> None:
    t = CYCLE * np.arange(1000) - 1.0
    x = -0.5 * 3.0 * np.maximum(t, 0.0) ** 2
    rng = np.random.default_rng(3)
    found = looked_at(x, np.where(t > 0, left, 8.0) + 0.05 * rng.normal(size=t.size))
    assert min(found) - 1.0 < 0.03
    assert min(found) < min(looked_at(x, np.full(1000, left))) - 0.01


def test_a_loop_that_drives_its_axis_away_is_told_from_a_load() -> None:
    t = CYCLE * np.arange(700) - 1.0
    w = 20.0
    x = np.where(t > 0, 1e-4 * np.cosh(w * np.maximum(t, 0.0)), 1e-4)
    found = looked_at(x, -(w**2) * x)
    assert found[min(found)].kind is Kind.DRIVEN


def test_noise_that_was_seen_at_rest_is_no_fall_and_what_falls_in_it_is_seen() -> None:
    rng = np.random.default_rng(2)
    limits = AxisLimits("A1", 2 * RATED, WINDOW, 5.0, COUNT, RATED, "rad", "N·m")
    axis = AxisEstimator(limits, CYCLE)
    for _ in range(200):
        axis.learn_noise(float(np.round(5 * rng.normal()) * COUNT))
    axis.use_noise()
    assert axis.noise == pytest.approx(5 * COUNT, rel=0.3)
    falls = []
    for k in range(60_000):
        fallen = 1.5 * max(0.0, k - 59_000) ** 2 * CYCLE**2
        axis.take(k * CYCLE, float(np.round(5 * rng.normal() - fallen / COUNT) * COUNT), 0.0, quiet=True)
        if axis.fall is not None:
            falls.append(k)
            break
    assert 59_000 < falls[0] < 59_200


def test_noise_of_several_counts_that_nobody_has_learnt_yet_is_judged_without_an_error() -> None:
    random = np.random.default_rng(62)
    for _ in range(40):
        axis = AxisEstimator(AxisLimits("A1", 2 * RATED, WINDOW, 5.0, COUNT, RATED, "rad", "N·m"), CYCLE)
        steps = 16 * COUNT * np.round(random.normal(0.0, 0.5, 400))
        for k, position in enumerate(np.concatenate([np.zeros(40), steps])):
            axis.take(k * CYCLE, float(position), 0.0)


@pytest.mark.parametrize(("acceleration", "falls"), [(0.0, False), (3.0, True)])
def test_what_falls_while_its_drive_is_only_asked_every_few_cycles_is_seen(
    acceleration: float, falls: bool
) -> None:
    axis = AxisEstimator(AxisLimits("A1", 2 * RATED, WINDOW, 5.0, COUNT, RATED, "rad", "N·m"), CYCLE)
    seen, fast = [], []
    for k in [0, *np.cumsum([2, 3, 2, 4] * 120).tolist()]:
        way = 0.5 * acceleration * max(0.0, k * CYCLE - 1.0) ** 2
        axis.take(k * CYCLE, -round(way / COUNT) * COUNT, 0.0)
        if axis.fall is not None:
            seen.append(way)
            fast.append(axis.fall.acceleration)
    assert bool(seen) is falls
    assert not falls or seen[0] < 0.006
    assert not falls or np.mean(fast[8:]) == pytest.approx(acceleration, rel=0.02)
    assert not falls or np.std(fast[8:]) < 1.7 * axis.sigma  # half as much again as if every sample came


def test_nobody_knows_what_an_axis_did_in_a_long_gap() -> None:
    limits = AxisLimits("A1", 2 * RATED, WINDOW, 5.0, COUNT, RATED, "rad", "N·m")
    axis = AxisEstimator(limits, CYCLE)
    for k in (*range(300), *range(312, 340)):  # it was moved, and stands
        axis.take(k * CYCLE, 0.0 if k < 300 else 0.05, 0.0)
        assert axis.fall is None
    assert not axis.leapt


@pytest.mark.parametrize(("noise", "count"), [(1e-5, 20), (1e-4, 40), (1e-3, 80), (5e-3, 160), (1.0, 160)])
def test_the_window_is_the_shortest_in_which_noise_leaves_a_fall_to_be_told(noise: float, count: int) -> None:
    found, sigma = window_of(noise, CYCLE)
    assert found == count
    quarters = noise * np.random.default_rng(1).normal(size=(20_000, 4, count // 4)).mean(axis=2)
    bends = quarters @ [1, -1, -1, 1] / (2 * (count / 4 * CYCLE) ** 2)
    assert sigma == pytest.approx(np.std(bends), rel=0.03)


@pytest.mark.parametrize(("step", "stands"), [(0.0, True), (0.9, True), (1.1, False)])
def test_an_axis_stands_that_stays_within_its_tolerance_for_so_long(step: float, stands: bool) -> None:
    axis = AxisEstimator(AxisLimits("A1", 2 * RATED, WINDOW, 5.0, COUNT, RATED, "rad", "N·m"), CYCLE)
    assert axis.tolerance == pytest.approx(max(8 * COUNT, 0.002 * WINDOW))
    for k in range(round(STAND_S / CYCLE) + 2):
        axis.take(k * CYCLE, step * axis.tolerance * (k == 100), 0.0)
        assert not axis.stands or k * CYCLE >= STAND_S - 1e-9
    assert axis.stands is stands
    axis.look_anew()
    assert not axis.stands


def test_few_samples_at_rest_teach_no_noise_and_a_slow_motion_is_none() -> None:
    limits = AxisLimits("A1", 2 * RATED, WINDOW, 5.0, COUNT, RATED, "rad", "N·m")
    axis = AxisEstimator(limits, CYCLE)
    for n in (LEARN_SAMPLES - 1, 500):
        for k in range(n):
            axis.learn_noise(0.01 * k if n == 500 else 0.01 * (k % 2))
        axis.use_noise()
        assert axis.noise == pytest.approx(COUNT / math.sqrt(12))


@pytest.mark.parametrize(
    ("speed", "way", "seconds", "leaps"),
    [
        (5.0, 0.05, 0.002, True),
        (5.0, 0.03, 0.002, False),
        (5.0, 0.05, 0.004, False),
        # one that stood, and is asked by SDO: its drive answers every few cycles
        (0.0, 0.05, 0.0055, True),
        (0.0, 0.03, 0.0055, False),
        (0.0, 0.03, 0.02, False),
    ],
)
def test_an_encoder_leaps_beyond_what_its_axis_goes_in_the_time(
    speed: float, way: float, seconds: float, leaps: bool
) -> None:
    axis = AxisEstimator(AxisLimits("A1", 2 * RATED, WINDOW, 5.0, COUNT, RATED, "rad", "N·m"), CYCLE)
    for k in range(100):
        axis.take(k * CYCLE, speed * k * CYCLE, 0.0)
    assert axis.speed == pytest.approx(speed)
    assert not axis.leapt
    axis.take(99 * CYCLE + seconds, axis.position + way, 0.0)
    assert bool(axis.leapt) is leaps


def test_an_encoder_that_leaps_is_named_and_not_the_speed_that_nobody_had() -> None:
    limits = AxisLimits("A1", 2 * RATED, WINDOW, 1.0, COUNT, RATED, "rad", "N·m")
    bounds = Bounds([limits], cycle_s=CYCLE, missed_tpdos=5, overrun_cycles=5)
    bounds.led = {0}
    bounds.start([0.0])
    for k in range(20):
        bounds.check(Sample(k, k * CYCLE, [0.0005 * k], [1.0], [0x37], [True]))
    with pytest.raises(SafetyStop, match=r"encoder leapt by 0.03.*cable") as said:
        bounds.check(Sample(20, 20 * CYCLE, [0.04], [1.0], [0x37], [True]))
    assert said.value.code == "leapt"
    assert bounds.blind == {0}


def test_what_holds_an_axis_is_the_mean_over_half_of_the_time_in_which_it_stands() -> None:
    axis = AxisEstimator(AxisLimits("A1", 2 * RATED, WINDOW, 5.0, COUNT, RATED, "rad", "N·m"), CYCLE)
    for k in range(400):
        axis.take(k * CYCLE, 0.0, 20.0 if k < 325 else 8.0 + (-1.0) ** k)
    assert axis.torque == pytest.approx(8.0, abs=0.02)
