"""The trials of the signs on a computer that is late: no accusation from samples that say nothing."""

import threading

import numpy as np
import pytest
from test_sweep import CYCLE, RigidCell, run

from invid.errors import SafetyStop
from invid.numerics.arrays import Bool, Float64
from invid.signals.excitation import doublet
from invid.sweep import Progress, Sample
from invid.sweep.inertia import rigid_branch
from invid.sweep.trials import DECISIVE, Response, judge, response, sign_score

COUNT = 1e-6


class BusyCell(RigidCell):
    """A computer that is held up: slots are skipped, and answers that come late count as not received."""

    def __init__(self, seed: int, share: float, sign: float = 1.0) -> None:
        super().__init__()
        self.sign[0] = sign
        self._rng, self._share = np.random.default_rng(seed), share
        self._late, self._shown = 0, [0.0, 0.0]
        self.disturb = self._hold_up

    def _hold_up(self, _cell: RigidCell, sample: Sample) -> None:
        if self._late < 0:
            self._late += 1  # more in a row are another fault
        elif self._late == 0 and self._rng.random() < self._share:
            self._late = int(self._rng.integers(1, 5))
        if self._late > 0:
            self._late = self._late - 1 or -1
            sample.position[:], sample.fresh[:] = self._shown, [False, False]
        self._shown = list(sample.position)


def verdict(cell: RigidCell) -> str:
    """What the trials of the signs say; empty where they let the run go on, which is stopped there."""
    stop = threading.Event()

    def after_the_signs(progress: Progress) -> None:
        if progress.phase == "trying the amplitude":
            stop.set()

    rows, error, _ = run(cell, stop=stop, progress=after_the_signs)
    assert isinstance(error, SafetyStop)
    assert rows.kept == []
    return "" if "on request" in str(error) else str(error)


@pytest.mark.parametrize("share", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("seed", [0, 2, 5])
def test_answers_that_come_late_never_make_an_encoder_run_backwards(seed: int, share: float) -> None:
    said = verdict(BusyCell(seed, share))
    assert said == "" or "could not tell" in said
    if share < 0.1:
        assert said == ""


@pytest.mark.parametrize("seed", [0, 2])
def test_a_wrong_sign_is_found_on_a_busy_computer_too(seed: int) -> None:
    assert "backwards" in verdict(BusyCell(seed, 0.05, sign=-1.0))


@pytest.mark.parametrize(("mobility", "drift"), [(1.0, 0.0), (-1.0, 0.0), (-0.02, 0.05)])
def test_a_whole_path_tells_the_sign_that_the_steps_of_a_coarse_encoder_leave_open(
    mobility: float, drift: float
) -> None:
    """With 16 bits the four edges of a doublet of 2 % of rated torque say 4 deviations. A path that something
    else made says nothing."""
    count = 2 * np.pi / 2**16
    demand: Float64 = np.concatenate([np.zeros(20), doublet(320), np.zeros(20)])
    time: Float64 = (CYCLE * np.arange(demand.size)).astype(np.float64)
    came = np.ones(demand.size, dtype=bool)
    path = np.cumsum(np.cumsum(demand)) * CYCLE**2
    position = (np.floor((mobility * path + drift * time) / count) * count).astype(np.float64)
    found = response(time, demand, demand, position, count=count, rated=50.0)
    assert abs(sign_score([found])) < DECISIVE
    assert rigid_branch(time, demand, position, came, count=count).is_opposed is (mobility == -1.0)


def test_a_computer_that_is_always_late_is_told_so_and_no_drive_is_blamed() -> None:
    cell = RigidCell()

    def late(c: RigidCell, s: Sample) -> None:
        if s.time > 0.31:
            c.slot += 1  # every second slot was missed
            s.fresh[:] = [s.slot % 8 == 0] * 2

    cell.disturb = late
    rows, error, _ = run(cell)
    assert isinstance(error, SafetyStop)
    assert error.exit_code == 4
    for words in ("could not tell", "late", "nothing was recorded", "Stop other programs"):
        assert words in str(error)
    assert rows.kept == []
    assert not cell.energised
    assert max(abs(float(x)) for x in cell.x) < 0.5


def test_a_computer_that_is_busy_for_a_few_seconds_is_waited_for() -> None:
    cell = RigidCell()

    def late(c: RigidCell, s: Sample) -> None:
        if 0.31 < s.time < 4.0:
            c.slot += 1
            s.fresh[:] = [s.slot % 8 == 0] * 2

    cell.disturb = late
    assert verdict(cell) == ""
    assert max(abs(float(x)) for x in cell.x) < 0.5


def seen(came: Bool, *, sign: float = 1.0) -> Response:
    """A rigid mass under a doublet; where no sample came, the last one stands."""
    wave = np.concatenate([np.zeros(40), doublet(160), np.zeros(40)])
    time = np.arange(wave.size, dtype=np.float64) * CYCLE
    velocity = np.cumsum(sign * wave) * CYCLE
    moved = (np.cumsum(velocity) - 0.5 * velocity) * CYCLE
    path = np.round(np.concatenate([[0.0], moved[:-1]]) / COUNT) * COUNT
    rows = np.maximum.accumulate(np.where(came, np.arange(wave.size), 0))
    return response(time, wave, wave[rows], path[rows], count=COUNT, rated=10.0, fresh=came)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_repeated_last_value_is_not_believed(sign: float) -> None:
    came = np.ones(240, dtype=bool)
    for edge in (40, 80, 160, 200):
        came[edge + 2 : edge + 10] = False  # always just after a step of torque
    found = seen(came, sign=sign)
    assert found.edges == 4
    assert not found.late
    assert found.mobility * sign > DECISIVE * found.mobility_std
    assert found.mobility == pytest.approx(sign, rel=0.02)


def test_a_measured_torque_of_the_other_sign_is_named() -> None:
    found = Response(1.0, 1.0, 1.0, 0.1, torque_slope=-0.9, edges=4)
    with pytest.raises(SafetyStop, match="opposite sign"):
        judge("A1", found, 10.0, amplitude=1.0, unit="rad", torque_unit="N·m")


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stiff_loop_that_drives_the_axis_back_is_no_wrong_sign(sign: float) -> None:
    mass, gain, kp, cycle = 1.3, 274.0, 20.0, 1e-3
    wave = 1.73 * np.concatenate([np.zeros(40), doublet(80), np.zeros(40)])
    x, v, path, torque, last, pending = 0.0, 0.0, [], [], 0.0, 0.0
    for asked in wave:
        shown = round(x / COUNT) * COUNT
        path.append(shown)
        torque.append(asked + pending)
        pending = -sign * gain * (kp * shown + (shown - last) / cycle)
        last = shown
        a = sign * torque[-1] / mass
        x, v = x + v * cycle + 0.5 * a * cycle**2, v + a * cycle
    time, whole, shown_path = np.arange(wave.size) * cycle, np.array(torque), np.array(path)
    alone = response(time, wave, wave, shown_path, count=COUNT, rated=69.0)
    found = response(time, wave, wave, shown_path, count=COUNT, rated=69.0, acting=whole)
    assert alone.mobility * sign < 0.5 / mass  # the demand alone does not say what acted
    assert found.mobility * sign > DECISIVE * found.mobility_std
    assert found.mobility * sign == pytest.approx(1 / mass, rel=0.1)
