"""Encoders that stand still: which stands are a fault and which are not."""

from collections.abc import Callable

import numpy as np
import pytest
from test_sweep import CYCLE, RigidCell, run

from invid.errors import SafetyStop
from invid.numerics.arrays import Float64
from invid.sweep import Sample
from invid.sweep.axis_estimator import AxisLimits
from invid.sweep.bounds import Bounds
from invid.sweep.stuck_encoder import Unmoved


def dying(when: Callable[[RigidCell, Sample], bool]) -> tuple[RigidCell, dict[str, float]]:
    """A cell whose first encoder dies once ``when`` holds; its last value "x" and the moment "at"."""
    cell = RigidCell()
    dead: dict[str, float] = {}

    def die(c: RigidCell, s: Sample) -> None:
        if dead or when(c, s):
            s.position[0] = dead.setdefault("x", s.position[0])
            dead.setdefault("at", s.time)

    cell.disturb = die
    return cell, dead


def test_an_encoder_that_dies_while_an_axis_is_caught_after_its_trial_is_found_there() -> None:
    cell, dead = dying(lambda c, s: s.time > 0.5 and abs(c.v[0]) > 0.1)
    _, error, _ = run(cell)
    assert isinstance(error, SafetyStop)
    assert "A1" in str(error)
    assert cell.clock.time < dead["at"] + 0.03


def test_an_encoder_that_dies_at_a_turning_point_of_the_trial_is_asked_once_more_and_found() -> None:
    """No speed is there to stop from; the doublet's last quarter stands, and the next doublet stands."""
    cell, dead = dying(lambda c, s: s.time > 0.6 and abs(c.x[0]) > 2e-3 and abs(c.v[0]) < 2e-3)
    _, error, _ = run(cell)
    assert isinstance(error, SafetyStop)
    assert "by 0 counts" in str(error)
    assert cell.clock.time < dead["at"] + 3.0
    assert not cell.energised


COUNT, WINDOW, MASS, WEIGHT, SHAKEN = 2 * np.pi / 2**16, 0.5, 1.0, 8.0, 12.0


def multisine(seed: int, seconds: float) -> Float64:
    """(n,) torque with lines from 2 to 20 Hz."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, seconds, CYCLE)
    lines = np.arange(2.0, 20.0)
    wave = sum(np.sin(2 * np.pi * f * time + p) for f, p in zip(lines, rng.uniform(0, 6.28, 18), strict=True))
    return np.asarray(SHAKEN * wave / np.abs(wave).max())


def shaken_mass(
    torque: Float64, friction: float, dies: float = np.inf, *, lag: int = 2
) -> tuple[float, float] | None:
    """A mass under a load and dry friction whose torque acts some cycles late: when it was said that its
    encoder stands, and how far the mass had gone since it died; its friction was met by a small doublet."""
    watch = Unmoved(["A1"], [COUNT], [WINDOW], CYCLE)
    watch.begin({0: (0.9 * MASS, WEIGHT)})
    watch.moved_by(0, friction + 0.2)
    x = v = 0.0
    shown = died_at = 0.0
    acting = [0.0] * lag
    for k, asked in enumerate(torque.tolist()):
        acting.append(asked)
        force = acting.pop(0)
        if v == 0.0 and abs(force) <= friction:
            after = 0.0
        else:
            drag = np.copysign(friction, v if v else force)
            after = v + (force - drag) / MASS * CYCLE
            if v and after * v < 0:
                after = 0.0
        v = after
        x += v * CYCLE
        now = k * CYCLE
        if now < dies:
            shown, died_at = np.floor(x / COUNT) * COUNT, x
        try:
            watch.check(Sample(k, now, [shown], [0.0], [0x27], [True], []), [WEIGHT + asked])
        except SafetyStop:
            return now, abs(x - died_at)
    return None


@pytest.mark.parametrize("friction", [0.0, 0.3, 2.0, 8.0])
@pytest.mark.parametrize("lag", [0, 2, 10])
def test_a_shaken_mass_that_turns_and_sticks_is_no_dead_encoder(friction: float, lag: int) -> None:
    assert shaken_mass(multisine(1, 40.0), friction, lag=lag) is None


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_an_encoder_that_dies_under_shaking_is_told_by_torque_that_must_have_moved_it(
    friction: float, seed: int
) -> None:
    dies = 3.0 + 0.137 * seed
    told = shaken_mass(multisine(seed, 10.0), friction, dies)
    assert told is not None
    assert 0.0 < told[0] - dies < 0.5  # a period of the slowest line
    assert told[1] < 0.05  # what it drifts at the speed at which it died


@pytest.mark.parametrize(("acceleration", "yields"), [(2.0, True), (-2.0, False)])
def test_a_led_axis_that_gets_faster_against_all_its_torque_ends_the_run_and_one_that_brakes_does_not(
    acceleration: float, yields: bool
) -> None:
    bounds = Bounds(
        [AxisLimits("A1", 5.0, 9.0, 5.0, 1e-4, 10.0, "rad", "N·m")],
        cycle_s=0.002,
        missed_tpdos=5,
        overrun_cycles=5,
    )
    bounds.led = {0}
    bounds.start([0.0])
    ended = False
    for k in range(200):
        t = 0.002 * k
        try:
            bounds.check(Sample(k, t, [t + acceleration / 2 * t**2], [-5.0], [0x37], [True]))
        except SafetyStop as error:
            ended = error.code == "yields"
            break
    assert ended is yields
    assert not yields or t < 0.25
