"""When a load may change: where it is accelerated before and after."""

import numpy as np
import pytest

from invid.effects.catalogue.payload_change import PayloadChangeLaw
from invid.effects.supposed.law import SpotMotion

LAW = PayloadChangeLaw()


def swing(begin: float, end: float, *, repeats: bool = False) -> SpotMotion:
    """A sinusoid of growing speed, as in a chirp."""
    time = np.arange(begin, end, 1e-3)
    phase = 0.5 * np.exp(0.3 * (time - begin))
    angle = np.sin(2 * np.pi * phase)
    return SpotMotion(angle, np.gradient(angle, 1e-3), angle, time, repeats=repeats)


def test_a_change_lies_where_the_load_is_accelerated_before_and_after() -> None:
    motion = swing(0.0, 10.0)
    ((low, high),) = LAW.bounds([motion])
    power = np.cumsum(motion.acceleration**2)
    for time, share in ((low, 0.05), (high, 0.95)):
        assert np.interp(time, motion.time, power / power[-1]) == pytest.approx(share, abs=0.01)
    assert all(low < shape[0] < high for shape in LAW.shapes([motion]))


def test_of_a_mean_of_periods_a_change_lies_between_records() -> None:
    before, after = swing(0.0, 4.0, repeats=True), swing(6.0, 10.0, repeats=True)
    ((time,),) = LAW.shapes([before, after])
    assert not LAW.waves(before, (time,)).any()
    np.testing.assert_array_equal(LAW.waves(after, (time,))[:, 0], after.acceleration)


def test_of_records_of_one_clock_that_repeat_no_change_is_supposed() -> None:
    assert LAW.shapes([swing(0.0, 4.0, repeats=True), swing(0.0, 4.0, repeats=True)]) == []
