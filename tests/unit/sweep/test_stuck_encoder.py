"""Encoders that stand still: which stands are a fault and which are not."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from test_sweep import CYCLE, RigidCell, run

from invid.errors import SafetyStop
from invid.numerics.arrays import Float64
from invid.sweep import Sample
from invid.sweep.obedience import Obedience
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


def friction_watch(friction: float) -> Unmoved:
    """Knows the mass, and its friction by a small doublet."""
    watch = Unmoved(["A1"], [COUNT], [WINDOW], CYCLE)
    watch.begin({0: (0.9 * MASS, WEIGHT)})
    watch.moved_by(0, friction + 0.2)
    return watch


def motion_watch(friction: float) -> Obedience:
    """Knows how the mass has followed a third of the torque in a trial."""
    watch = Obedience(["A1"], [COUNT], CYCLE)
    watch.shake({0})
    torque = multisine(77, 4.0) / 3.0
    x = np.array(list(motion(torque, friction, 2)))
    fresh = np.ones(torque.size, dtype=bool)
    watch.learn(0, np.arange(torque.size) * CYCLE, WEIGHT + torque, counted(x), fresh, 20.0)
    return watch


def motion(torque: Float64, friction: float, lag: int) -> Iterator[float]:
    """Places of a mass under dry friction whose torque acts some cycles late."""
    x = v = 0.0
    acting = [0.0] * lag
    for asked in torque.tolist():
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
        yield x


def counted(x: Any) -> Any:
    """As an encoder shows it."""
    return np.floor(x / COUNT) * COUNT


def told(
    watch: Unmoved | Obedience, torque: Float64, friction: float, dies: float = np.inf, *, lag: int = 2
) -> tuple[float, float] | None:
    """When it was said that an encoder stands, and how far its mass had gone since it died."""
    shown = died_at = 0.0
    for k, (asked, x) in enumerate(zip(torque.tolist(), motion(torque, friction, lag), strict=True)):
        now = k * CYCLE
        if now < dies:
            shown, died_at = float(counted(x)), x
        try:
            watch.check(Sample(k, now, [shown], [0.0], [0x27], [True], []), [WEIGHT + asked])
        except SafetyStop:
            return now, abs(x - died_at)
    return None


WATCHES = pytest.mark.parametrize("knowing", [friction_watch, motion_watch])


@WATCHES
@pytest.mark.parametrize("friction", [0.0, 0.3, 2.0, 8.0])
@pytest.mark.parametrize("lag", [0, 2, 10])
def test_a_shaken_mass_that_turns_and_sticks_is_no_dead_encoder(
    knowing: Callable[[float], Unmoved | Obedience], friction: float, lag: int
) -> None:
    assert told(knowing(friction), multisine(1, 40.0), friction, lag=lag) is None


@WATCHES
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_an_encoder_that_dies_under_shaking_is_told_by_torque_that_must_have_moved_it(
    knowing: Callable[[float], Unmoved | Obedience], friction: float, seed: int
) -> None:
    dies = 3.0 + 0.137 * seed
    said = told(knowing(friction), multisine(seed, 10.0), friction, dies)
    assert said is not None
    assert 0.0 < said[0] - dies < 0.55  # a period of the slowest line; 32 blocks of motion
    assert said[1] < 0.1  # what it drifts at the speed at which it died
