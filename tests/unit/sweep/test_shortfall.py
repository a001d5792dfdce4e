"""Shown against asked torque: less under a load, the opposite under none; a late display is neither."""

import numpy as np
import pytest

from invid.errors import SafetyStop
from invid.sweep.ports import Sample
from invid.sweep.shortfall import HeldTorque, Shortfall

CYCLE, RATED, TURNS = 0.002, 10.0, 3.0


def ended_at(asked: np.ndarray, shown: np.ndarray, loaded: set[int]) -> tuple[float, str]:
    """When a run ends and why; infinity where it does not."""
    watch = Shortfall(["A1"], [RATED], "N·m", CYCLE)
    for k, (a, b) in enumerate(zip(asked, shown, strict=True)):
        try:
            watch.check(Sample(k, k * CYCLE, [0.0], [float(b)], [0x37], [True]), [float(a)], loaded)
        except SafetyStop as error:
            return k * CYCLE, str(error.code)
    return np.inf, ""


def shaken(hz: float, *, lag: int = 0, turns: bool = False) -> tuple[np.ndarray, np.ndarray]:
    t = CYCLE * np.arange(3000)
    asked = 2.0 * np.sin(2 * np.pi * hz * t) + 1.0 * np.sin(2 * np.pi * 1.7 * hz * t + 1.0)
    shown = np.concatenate([np.zeros(lag), asked[: asked.size - lag]])
    shown = np.where(t > TURNS, -shown, shown) if turns else shown
    return asked, shown + 0.05 * np.random.default_rng(4).normal(size=t.size)


@pytest.mark.parametrize("hz", [0.5, 2.0, 8.0])
@pytest.mark.parametrize("lag", [0, 3, 10])
def test_torque_that_turns_is_seen_of_an_axis_without_a_load_and_one_that_obeys_goes_on(
    hz: float, lag: int
) -> None:
    assert ended_at(*shaken(hz, lag=lag), set()) == (np.inf, "")
    when, code = ended_at(*shaken(hz, lag=lag, turns=True), set())
    assert code == "torque_turned"
    assert TURNS < when < TURNS + max(0.1, 0.3 / hz)


def test_a_display_that_lags_by_more_than_is_known_is_no_torque_that_turns() -> None:
    assert ended_at(*shaken(4.0, lag=40), set()) == (np.inf, "")


def test_less_than_asked_ends_a_run_under_a_load_and_none_without_one() -> None:
    t = CYCLE * np.arange(3000)
    asked = np.full(t.size, 8.0) + np.sin(2 * np.pi * 3.0 * t)
    shown = np.where(t > TURNS, np.minimum(asked, 5.0), asked)
    when, code = ended_at(asked, shown, {0})
    assert code == "no_torque"
    assert when < TURNS + 0.02
    assert ended_at(asked, shown, set()) == (np.inf, "")


@pytest.mark.parametrize(
    ("grip", "shown", "found"),
    [(None, 0.7, True), (0.1, 0.7, True), (2.6, 0.7, False), (np.inf, 0.7, False), (np.inf, 4.4, False)],
)
def test_a_standing_load_is_not_carried_unless_friction_could_hold_it(
    grip: float | None, shown: float, found: bool
) -> None:
    """It took 4.4 to hold it; a worm gear lets that fall to anything."""
    watch = HeldTorque([50.0], [1e-4], CYCLE)
    watch.grips |= {} if grip is None else {0: grip}
    seen = []
    for k in range(2000):
        torque = 4.4 if k < 1000 else shown
        seen += watch.missing(Sample(k, k * CYCLE, [0.0], [torque], [0x37], [True]), {0: 4.4}, {0})
        assert k >= 1000 or not seen
    assert bool(seen) is found
