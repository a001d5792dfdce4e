"""Encoders that stand still: which stands are a fault and which are not."""

import pytest
from test_sweep import CYCLE, RigidCell, after, config, run

from invid.errors import SafetyStop
from invid.sweep import Sample
from invid.sweep.standing import LIFE_CHANGES, STUCK_S, Standing
from invid.sweep.watch import AxisLimits, Watch


def trembling(cell: RigidCell, sample: Sample) -> None:
    """The held axis A2 feels what A1 does, by a count."""
    sample.position[1] += 1e-6 * (sample.slot // 3 % 2)


def test_a_held_axis_that_trembled_with_the_others_and_stops_trembling_is_a_stuck_encoder() -> None:
    cell = RigidCell()

    def disturb(c: RigidCell, s: Sample) -> None:
        if s.time < 30.0:
            trembling(c, s)

    cell.disturb = disturb
    longer = (
        "{kind: multisine, period_s: 2.0, periods: 9, settle_periods: 1, band_Hz: [6, 12], experiments: 1}"
    )
    _, error, _ = run(cell, config(longer), axes=["A1"])
    assert isinstance(error, SafetyStop)
    assert "A2" in str(error)
    assert "trembled" in str(error)
    assert 30.0 < cell.clock.time < 30.5


def test_a_held_axis_that_never_trembles_is_no_fault() -> None:
    cell = RigidCell()
    _, error, _ = run(cell, axes=["A1"])
    assert error is None
    assert cell.x[1] == 0


def sample(position: float, *, fresh: bool = True, slot: int = 0) -> Sample:
    return Sample(slot, slot * CYCLE, [position], [0.0], [0x0227], [fresh], [])


def test_an_axis_may_stand_three_times_as_long_as_it_stood_in_the_trial() -> None:
    standing = Standing(["A1"], CYCLE)
    standing.excited = {0}
    for move in range(5):
        for _ in range(50):  # 0.1 s at each place: friction holds it
            standing.check(sample(move))
    standing.learn({0})
    for _ in range(148):  # the first is the change, then three times the 49 repetitions
        standing.check(sample(9.0))
    with pytest.raises(SafetyStop, match="shown one value"):
        standing.check(sample(9.0))


def test_samples_that_do_not_come_are_no_stand() -> None:
    standing = Standing(["A1"], CYCLE)
    standing.excited = {0}
    for _ in range(2 * round(STUCK_S / CYCLE)):
        standing.check(sample(1.0, fresh=False))


def test_an_encoder_that_changed_too_rarely_is_not_expected_to_go_on() -> None:
    standing = Standing(["A1"], CYCLE)
    standing.expect_life({0}, 1000)
    for k in range(1000):
        standing.check(sample(k // 20))  # fifty changes
    assert LIFE_CHANGES > 50
    for _ in range(5000):
        standing.check(sample(0.5))


def test_a_gap_in_the_samples_is_no_leap_of_the_velocity() -> None:
    """Four cycles' way over the time of one would be four times the speed."""
    limits = AxisLimits("A1", 10, 10, 1.1, 1e-6, 10, "rad", "N·m")
    watch = Watch([limits], cycle_s=CYCLE, missed_tpdos=100, overrun_cycles=100)
    watch.start([0.0])
    for slot in range(500):
        lost = slot % 50 in range(20, 40)
        at = slot * CYCLE if not lost else (slot - slot % 50 + 19) * CYCLE  # 1 rad/s; the last one repeated
        watch.check(sample(at, fresh=not lost, slot=slot))
    assert watch.statistics.peak_velocity is not None
    assert watch.statistics.peak_velocity[0] == pytest.approx(1.0, abs=0.01)


def test_a_stuck_encoder_of_an_excited_axis_is_found_within_three_times_its_longest_stand() -> None:
    cell = RigidCell()
    held: dict[str, float] = {}
    cell.disturb = after(22.0, lambda c, s: s.position.__setitem__(0, held.setdefault("x", s.position[0])))
    _, error, _ = run(cell)
    assert isinstance(error, SafetyStop)
    assert "A1" in str(error)
    assert cell.clock.time < 22.0 + 0.4
