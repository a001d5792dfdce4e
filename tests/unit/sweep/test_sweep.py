"""The sweep engine against a cell of rigid masses written for these tests: it stops, always."""

import threading
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from typing import Any

import numpy as np
import pytest

from invid.config import CellConfig, parse_config
from invid.errors import BusError, ConfigError, DriveError, InvidError, SafetyStop
from invid.planning import make_plan
from invid.planning.model import PlannedExperiment
from invid.signals.excitation import doublet
from invid.sweep import Event, Mode, Progress, Sample, Severity, Sweep
from invid.sweep.bounds import AxisLimits, Bounds, bounds_of
from invid.sweep.ports import Procedure, Want
from invid.sweep.trials import response

CYCLE = 0.002
EXPERIMENT = (
    "{kind: multisine, period_s: 2.0, periods: 2, settle_periods: 1, band_Hz: [1, 12], experiments: 1}"
)


def config(experiments: str = EXPERIMENT, *, axis: str = "", limits: str = "", count: int = 2) -> CellConfig:
    rows = "\n".join(
        f"  - {{name: A{i + 1}, node_id: {i + 1}{axis}, "
        f"limits: {{torque: 10, position: 0.5, velocity: 5{limits}}}}}"
        for i in range(count)
    )
    return parse_config(
        "format: invid-config\nrobot: r\nbus: {interface: x, channel: x, cycle_s: "
        f"{CYCLE}}}\naxes:\n{rows}\nexperiments: [{experiments}]\n"
    )


class VirtualClock:
    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        return self.time

    def sleep_until(self, instant: float) -> None:
        self.time = max(self.time, instant)


class RigidCell:
    """Independent masses, exact between cycles; ``disturb`` may change each sample before it is seen."""

    def __init__(self, inertia: Sequence[float] = (1.0, 2.0)) -> None:
        self.m = np.array(inertia)
        self.x, self.v = np.zeros(self.m.size), np.zeros(self.m.size)
        self.clock = VirtualClock()
        self.axes = tuple(f"A{i + 1}" for i in range(self.m.size))
        self.can_hold = (True,) * self.m.size
        self.resolution = (1e-6,) * self.m.size
        self.rated_torque = (10.0,) * self.m.size
        self.by_offset = (False,) * self.m.size
        self.bounds: Bounds | None = None
        self.modes: list[Mode] = []
        self.energised = False
        self.stops = 0
        self.slot = -1
        self.push = np.zeros(self.m.size)
        self.sign = np.ones(self.m.size)
        self.disturb: Callable[[RigidCell, Sample], None] = lambda cell, sample: None
        self.demands: list[list[float]] = []

    changing = False

    def run(self, procedure: Procedure[Any]) -> None:
        with closing(procedure), suppress(StopIteration):
            wish = next(procedure)
            while True:
                self.modes = [Mode.TORQUE if want is Want.LEAD else Mode.HOLD for want in wish.wants]
                wish = procedure.send(self.exchange(wish.torque))

    def energise(self, modes: Sequence[Mode]) -> Procedure[None]:
        self.modes, self.energised = list(modes), True
        yield from ()

    def secure(self, loaded: Sequence[bool]) -> Procedure[bool]:
        self.loaded = list(loaded)
        yield from ()
        return False

    def set_loops(self, loops: Sequence[Any]) -> None:
        """It is at rest at once."""

    def exchange(self, torque: Sequence[float]) -> Sample:
        held = np.array([m is Mode.HOLD for m in self.modes])
        self.slot += 1
        self.clock.time = self.slot * CYCLE
        sample = Sample(
            self.slot,
            self.clock.time,
            [float(q) for q in self.sign * np.round(self.x / 1e-6) * 1e-6],
            [0.0 if h else float(t) for h, t in zip(held, torque, strict=True)],
            [0x0227] * self.m.size,
            [True] * self.m.size,
            [],
        )
        acceleration = np.where(held, 0.0, (np.array(torque) + self.push) / self.m)
        self.x = np.where(held, self.x, self.x + self.v * CYCLE + 0.5 * acceleration * CYCLE**2)
        self.v = np.where(held, 0.0, self.v + acceleration * CYCLE)
        self.demands.append(list(torque))
        self.disturb(self, sample)
        assert self.bounds is not None
        self.bounds.led = {i for i, mode in enumerate(self.modes) if mode is Mode.TORQUE}
        self.bounds.check(sample)
        return sample

    def stop(self) -> None:
        self.stops += 1
        self.energised = False


class Rows:
    """A sink that counts."""

    def __init__(self) -> None:
        self.kept: list[tuple[PlannedExperiment, list[float], list[int]]] = []
        self.open = False

    def begin(self, experiment: PlannedExperiment, hold_gain: Sequence[float], scale: float) -> None:
        self.kept.append((experiment, list(hold_gain), []))
        self.open = True

    def row(self, sample: Sample, demand: Sequence[float]) -> None:
        self.kept[-1][2].append(sample.slot)

    def end(self) -> None:
        self.open = False


def run(
    cell: RigidCell,
    cfg: CellConfig | None = None,
    *,
    stop: threading.Event | None = None,
    progress: Callable[[Progress], None] | None = None,
    axes: list[str] | None = None,
) -> tuple[Rows, InvidError | None, Sweep]:
    cfg = cfg or config(count=cell.m.size)
    rows = Rows()
    cell.bounds = bounds_of(cfg, cell.resolution, cell.rated_torque)
    sweep = Sweep(make_plan(cfg, axes=axes), cfg, cell, rows, progress=progress, stop=stop)
    try:
        sweep.run()
    except InvidError as error:
        return rows, error, sweep
    return rows, None, sweep


def after(seconds: float, what: Callable[[RigidCell, Sample], None]) -> Callable[[RigidCell, Sample], None]:
    return lambda cell, sample: what(cell, sample) if sample.time > seconds else None


def test_no_demand_ever_exceeds_the_torque_limit() -> None:
    cell = RigidCell((0.05, 0.05))
    run(cell)
    assert np.abs(cell.demands).max() <= 10.0


def test_a_light_axis_is_shaken_less_so_that_it_stays_in_its_window() -> None:
    cell = RigidCell((0.03, 2.0))
    furthest = [0.0]

    def look(c: RigidCell, sample: Sample) -> None:
        furthest[0] = max(furthest[0], abs(sample.position[0]))

    cell.disturb = look
    rows, error, sweep = run(cell)
    assert error is None
    assert len(rows.kept) == 1
    (said,) = [w for w in sweep.warnings if "could be" in w]
    could, allowed = (float(said.split(f"{word} ")[1].split()[0]) for word in ("could be", "trial,"))
    assert float(said.rsplit(" ", 1)[1]) == pytest.approx(allowed / could, abs=0.01)
    assert furthest[0] < 0.5


def test_an_axis_that_would_be_too_fast_is_shaken_less_so_that_it_stays_below_its_limit() -> None:
    cfg, stop = config(count=1), threading.Event()
    limits = cfg.axes[0].limits.model_copy(update={"velocity": 0.5, "position": 5.0})
    cfg = cfg.model_copy(update={"axes": [cfg.axes[0].model_copy(update={"limits": limits})]})

    def after_the_trials(progress: Progress) -> None:
        if progress.phase.startswith("experiment"):
            stop.set()

    _, error, sweep = run(RigidCell((1.0,)), cfg, stop=stop, progress=after_the_trials)
    assert "on request" in str(error)
    assert any("velocity could be" in w and "0.475 is allowed" in w for w in sweep.warnings)


FAULTS: list[tuple[str, Callable[[RigidCell, Sample], None], type[InvidError], str]] = [
    ("leap", lambda c, s: s.position.__setitem__(0, 0.6), SafetyStop, "encoder leapt"),
    (
        "velocity",
        lambda c, s: s.position.__setitem__(0, s.position[0] + 0.012 * (s.slot % 50)),
        SafetyStop,
        "velocity",
    ),
    ("torque", lambda c, s: s.torque.__setitem__(1, 14.0), SafetyStop, "torque"),
    ("tpdo", lambda c, s: s.fresh.__setitem__(0, False), DriveError, "no position"),
    (
        "emcy",
        lambda c, s: s.events.append(Event(Severity.DRIVE, "A1 reports 0x2310", "A1")),
        DriveError,
        "0x2310",
    ),
    ("bus", lambda c, s: s.events.append(Event(Severity.BUS, "bus-off")), BusError, "bus-off"),
    ("overrun", lambda c, s: setattr(c, "slot", c.slot + 50), SafetyStop, "late"),
]


MOMENTS = (0.1, 1.0, 4.0, 12.0)


@pytest.mark.parametrize(
    ("name", "fault", "kind", "word", "moment"),
    [(*fault, MOMENTS[(k + n) % 4]) for n, fault in enumerate(FAULTS) for k in (0, 2)],
)
def test_every_fault_at_any_phase_stops_every_axis_and_keeps_the_rows_so_far(
    name: str, fault: Callable[[RigidCell, Sample], None], kind: type[InvidError], word: str, moment: float
) -> None:
    cell = RigidCell()
    cell.disturb = after(moment, fault)
    rows, error, _ = run(cell)
    assert isinstance(error, kind)
    if name == "velocity" and moment in (0.1, 4.0):
        word = "is to stand and gets faster"
    assert word in str(error)
    assert not cell.energised
    assert not rows.open
    # stopped within the missed TPDOs allowed, or within a few cycles
    assert cell.clock.time < moment + 6 * CYCLE + (50 * CYCLE if name == "overrun" else 0) + 0.02


@pytest.mark.parametrize("passes_on", [False, True])
def test_where_held_axes_answer_to_an_encoder_that_shows_nothing_the_torque_does_not_grow(
    passes_on: bool,
) -> None:
    """Without an answer it may be friction, and the torque grows to what is planned."""
    cell = RigidCell()

    def shaken(c: RigidCell, s: Sample) -> None:
        s.position[0] = 0.0  # type: ignore[index]
        if passes_on and c.modes[1] is Mode.HOLD:
            s.torque[1] = 0.4 * c.demands[-1][0]  # type: ignore[index]

    cell.disturb = shaken
    _, error, _ = run(cell)
    assert isinstance(error, SafetyStop)
    assert error.code == "stands"
    assert error.axis == "A1"
    most = max(abs(d[0]) for d in cell.demands)
    first = next(abs(d[0]) for d in cell.demands if d[0])
    assert most <= 10.01 * first if passes_on else most > 15 * first


def test_a_stop_on_request_fades_out_and_counts_as_a_safety_stop() -> None:
    cell = RigidCell()
    event = threading.Event()
    cell.disturb = after(18.0, lambda c, s: event.set())
    _rows, error, _ = run(cell, stop=event)
    assert isinstance(error, SafetyStop)
    assert "request" in str(error)
    assert not cell.energised
    assert cell.clock.time < 18.0 + 0.1 + 5 * CYCLE
    jumps = np.abs(np.diff(np.array(cell.demands)[-50:], axis=0)).max()
    assert jumps < 2.0


def test_a_stop_that_was_asked_for_before_the_start_enables_no_drive() -> None:
    cell = RigidCell()
    stop = threading.Event()
    stop.set()
    rows, error, _ = run(cell, stop=stop)
    assert isinstance(error, SafetyStop)
    assert "nothing was recorded" in str(error)
    assert cell.modes == []  # never energised
    assert rows.kept == []


def test_whatever_goes_wrong_inside_the_cell_is_stopped() -> None:
    cell = RigidCell()

    def explode(c: RigidCell, s: Sample) -> None:
        raise ZeroDivisionError

    cell.disturb = after(5.0, explode)
    with pytest.raises(ZeroDivisionError):
        run(cell)
    assert cell.stops == 1


def test_a_drive_that_cannot_hold_is_held_by_the_master_and_a_push_dies_away() -> None:
    cell = RigidCell()
    cell.can_hold = (False, True)

    def kick(c: RigidCell, s: Sample) -> None:
        if 17.0 < s.time <= 17.0 + CYCLE:
            c.v[0] += 0.1

    cell.disturb = kick
    rows, error, sweep = run(cell, axes=["A2"])
    assert error is None
    assert rows.kept[0][1][0] == pytest.approx(0.5 * 10 / 0.5)  # half its torque at the edge of its window
    assert sweep.statistics.peak_travel is not None
    assert sweep.statistics.peak_travel[0] > 0.01
    assert abs(cell.x[0]) < 3e-3
    assert abs(cell.v[0]) < 1e-2


class LoadedCell(RigidCell):
    """A drive that holds its axis shows the torque that this takes."""

    def exchange(self, torque: Sequence[float]) -> Sample:
        held = [m is Mode.HOLD for m in self.modes]
        sample = super().exchange(torque)
        sample.torque[:] = [
            float(-p) if h else t for h, p, t in zip(held, self.push, sample.torque, strict=True)
        ]
        return sample


def test_a_loaded_axis_does_not_sag_when_the_master_takes_over_from_its_drive() -> None:
    cell, stop = LoadedCell((1.0, 2.0)), threading.Event()
    cell.push[:] = -3.0
    cell.disturb = after(0.7, lambda c, s: stop.set())
    _, error, sweep = run(cell, config(axis=", gravity_loaded: true, brake: none"), stop=stop)
    assert "on request" in str(error)
    assert sweep.statistics.peak_travel is not None
    assert sweep.statistics.peak_travel[0] < 0.02  # 3 N·m on 1 kg·m² for a fifth of a second would be 0.06


def test_an_unstable_hold_is_refused_before_anything_is_enabled() -> None:
    cell = RigidCell()
    _, error, _ = run(cell, config(axis=", hold: {mode: master_p, gain: 100000}"))
    assert isinstance(error, ConfigError)
    assert cell.slot == -1


@pytest.mark.parametrize("late", [0, 2, 9, 24])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_torque_that_follows_late_is_not_taken_for_one_of_the_wrong_sign(late: int, sign: float) -> None:
    wave = np.concatenate([np.zeros(40), doublet(48), np.zeros(40)])
    answer = sign * np.concatenate([np.zeros(late), wave[: wave.size - late]])
    position = np.cumsum(np.cumsum(answer)) * 1e-6
    found = response(
        np.arange(wave.size) * 1e-3, wave, answer, np.round(position / 1e-7) * 1e-7, count=1e-7, rated=10.0
    )
    assert found.torque_slope == pytest.approx(sign, rel=0.05)
    assert found.mobility * sign > 5 * found.mobility_std


def watched(position: float, torque: float, speed: float) -> None:
    """Forty cycles of one axis with limits of 1 rad/s and 10 N·m (rated 20) at a torque and a speed."""
    limits = AxisLimits("A1", 10.0, 1.0, 1.0, 1e-9, 20.0, "rad", "N·m")
    bounds = Bounds([limits], cycle_s=CYCLE, missed_tpdos=5, overrun_cycles=5)
    bounds.start([0.0])
    for slot in range(40):
        at = position + speed * slot * CYCLE
        bounds.check(Sample(slot, slot * CYCLE, [at], [torque], [0x27], [True], []))


def test_each_limit_stops_just_beyond_what_its_sensor_may_be_wrong_by() -> None:
    watched(0.999, 11.5, 0.0)
    watched(0.0, -11.5, -1.04)
    with pytest.raises(SafetyStop, match="window"):
        watched(1.001, 0.0, 0.0)
    with pytest.raises(SafetyStop, match=r"torque 11\.7"):  # a tenth, and 3 % of the rated torque: 11.6
        watched(0.0, -11.7, 0.0)
    with pytest.raises(SafetyStop, match="velocity"):  # SYNC is known to a fifth of four cycles: 1.05
        watched(0.0, 0.0, 1.06)


def test_an_axis_whose_encoder_runs_backwards_is_found_at_a_tenth_of_the_amplitude() -> None:
    cell = RigidCell()
    cell.sign[1] = -1
    rows, error, _ = run(cell)
    assert isinstance(error, SafetyStop)
    assert "A2" in str(error)
    assert "backwards" in str(error)
    assert np.abs(cell.demands).max() <= 0.1 * 0.7 * 10.0 * 1.6
    assert rows.kept == []
    assert not cell.energised


def test_an_axis_that_does_not_move_is_found_before_the_full_amplitude() -> None:
    cell = RigidCell((1e9, 1.0))
    rows, error, _ = run(cell)
    assert isinstance(error, SafetyStop)
    assert "brake" in str(error)
    assert rows.kept == []


def test_a_person_who_pushes_the_arm_is_noticed_by_the_window() -> None:
    cell = RigidCell()
    cell.disturb = after(26.0, lambda c, s: c.push.__setitem__(0, 30.0))
    rows, error, _ = run(cell)
    assert isinstance(error, SafetyStop)
    assert len(rows.kept) == 1
    assert 0 < len(rows.kept[0][2]) < 2000
    # what the window allows, and two cycles at a speed below 6 rad/s
    assert abs(cell.x[0]) < 0.5 + 2 * 6 * CYCLE
