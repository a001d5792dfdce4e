"""One list of promises, kept by every adapter: our simulated drives, drives of another hand,
and real hardware where INVID_HARDWARE names a config."""

import os
from collections.abc import Iterator
from typing import Any

import can
import numpy as np
import pytest
from foreign_bus import ForeignBus
from hypothesis import given, settings
from hypothesis import strategies as st
from stepping import energise, exchange, set_modes

from invid.config import CellConfig, load_config
from invid.errors import BusError, DriveError, InvidError
from invid.sweep import Cell, Mode
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.journal import Journal
from invid_drivers.connect import connect
from invid_drivers.simulated import open_virtual_bus

CYCLE = 0.002
OPERATION_ENABLED = 0x27


def config(simulation: dict[str, Any] | None = None, **axis: Any) -> CellConfig:
    limits = {"torque_Nm": 5, "position_window_rad": 1.0, "velocity_rad_per_s": 10}
    return CellConfig.model_validate(
        {
            "format": "invid-config",
            "robot": "promises",
            "bus": {"interface": "invid-virtual", "channel": "promises", "cycle_s": CYCLE},
            "axes": [
                {"name": f"A{n}", "node_id": n, "limits": limits, "gravity_loaded": False, **axis}
                for n in (1, 2)
            ],
            "simulation": {
                "plant": {"branches": [{"axis": "A1", "masses": [1.0]}, {"axis": "A2", "masses": [2.0]}]},
                "defaults": {"rated_torque_Nm": 10, "encoder_counts_per_rev": 1 << 20},
                **(simulation or {}),
            },
        }
    )


def simulated() -> Cia402Cell:
    cfg = config()
    return Cia402Cell(open_virtual_bus(cfg), cfg)


def foreign_bus(lacks: frozenset[int] = frozenset(), found: dict[int, int] | None = None) -> ForeignBus:
    """Two masses without friction."""
    spec = {"lacks": [f"{i:x}" for i in lacks], "found": {f"{i:x}00": v for i, v in (found or {}).items()}}
    plants = ({"inertia": m, "viscous": 0.0, "coulomb": 0.0, "low": -9.0, "high": 9.0} for m in (1.0, 2.0))
    bus = ForeignBus(*({**spec, "plant": plant} for plant in plants))
    for axis in bus.axes:
        axis.faults_by_following = 0x6065 not in lacks
    return bus


def foreign() -> Cia402Cell:
    return Cia402Cell(foreign_bus(), config())


def hardware() -> Cia402Cell:
    path = os.environ.get("INVID_HARDWARE")
    if not path:
        pytest.skip("no hardware: set INVID_HARDWARE to a cell's config, with the machine free to move")
    return connect(load_config(path))


ADAPTERS = [
    pytest.param(simulated, id="simulated drives"),
    pytest.param(foreign, id="drives of another hand"),
    pytest.param(hardware, id="hardware", marks=pytest.mark.hardware),
]


@pytest.fixture(params=ADAPTERS)
def cell(request: pytest.FixtureRequest) -> Iterator[Cell]:
    made = request.param()
    made.check()
    yield made
    made.stop()
    made.close()


def held(cell: Cell) -> list[Mode]:
    return [Mode.HOLD] * len(cell.axes)


def zero(cell: Cell) -> list[float]:
    return [0.0] * len(cell.axes)


class TestPromisesOfEveryAdapter:
    def test_energised_axes_are_fresh_and_enabled(self, cell: Cell) -> None:
        energise(cell, held(cell))
        sample = exchange(cell, zero(cell))
        assert all(sample.fresh)
        assert [s & 0x6F for s in sample.status] == [OPERATION_ENABLED] * len(cell.axes)

    def test_slots_count_up_and_their_instants_are_a_cycle_apart(self, cell: Cell) -> None:
        energise(cell, held(cell))
        slots, times = [], []
        for _ in range(100):
            sample = exchange(cell, zero(cell))
            slots.append(sample.slot)
            times.append(sample.time)
        assert np.all(np.diff(slots) == 1)
        np.testing.assert_allclose(np.diff(times), CYCLE, atol=1e-6)

    def test_stop_works_from_any_state_any_number_of_times(self, cell: Cell) -> None:
        cell.stop()
        cell.stop()
        energise(cell, held(cell))
        cell.stop()
        cell.stop()

    def test_a_cell_that_was_stopped_can_be_energised_again(self, cell: Cell) -> None:
        for _ in range(2):
            energise(cell, held(cell))
            assert exchange(cell, zero(cell)).status[0] & 0x6F == OPERATION_ENABLED
            cell.stop()


@pytest.fixture(params=ADAPTERS[:2])
def drives(request: pytest.FixtureRequest) -> Iterator[Cia402Cell]:
    made: Cia402Cell = request.param()
    made.check()
    yield made
    made.close()


class TestPromisesOfEveryDrive:
    def test_positive_torque_moves_an_axis_forward_and_a_held_axis_stays(self, drives: Cia402Cell) -> None:
        energise(drives, [Mode.HOLD, Mode.HOLD])
        set_modes(drives, [Mode.TORQUE, Mode.HOLD])
        first = list(exchange(drives, [0.0, 0.0]).position)
        for _ in range(200):
            sample = exchange(drives, [1.0, 1.0])
        # ½·a·t² with 1 N·m on 1 kg·m² for 0.4 s, a few cycles of delay
        assert sample.position[0] - first[0] == pytest.approx(0.5 * 0.4**2, rel=0.05)
        assert abs(sample.position[1] - first[1]) < 1e-4

    def test_measured_torque_follows_the_demand(self, drives: Cia402Cell) -> None:
        energise(drives, [Mode.TORQUE, Mode.TORQUE])
        for _ in range(20):
            sample = exchange(drives, [0.5, -0.25])
        assert sample.torque == pytest.approx([0.5, -0.25], abs=0.02)

    def test_after_stop_no_drive_is_energised(self, drives: Cia402Cell) -> None:
        energise(drives, [Mode.TORQUE, Mode.TORQUE])
        for _ in range(50):
            exchange(drives, [1.0, 1.0])
        drives.stop()
        assert drives.not_off == ()

    def test_every_object_written_is_as_before_after_close(self, drives: Cia402Cell) -> None:
        addresses = [
            (0x605A, 0),
            (0x6072, 0),
            (0x607D, 1),
            (0x607D, 2),
            (0x1016, 1),
            (0x1017, 0),
            (0x6065, 0),
        ]
        addresses += [(0x1400, 2), (0x1600, 0), (0x1A00, 0), (0x1800, 2)]
        link = drives._link

        def values() -> list[bytes]:
            return [bytes(link.sdo(1).upload(i, s)) for i, s in addresses]

        before = values()
        energise(drives, [Mode.HOLD, Mode.HOLD])
        assert values() != before
        drives.stop()
        drives._restore([])
        assert values() == before
        assert drives.journal.entries == ()

    def test_protection_stands_in_the_drive_before_it_is_enabled(self, drives: Cia402Cell) -> None:
        energise(drives, [Mode.HOLD, Mode.HOLD])
        link = drives._link

        def value(index: int, sub: int = 0) -> int:
            return int.from_bytes(bytes(link.sdo(1).upload(index, sub)), "little", signed=True)

        window = 1.25 / drives.resolution[0]  # the limit and the drive's margin
        assert value(0x6072) == round(1000 * 5 / drives.rated_torque[0])
        assert value(0x607D, 2) - value(0x607D, 1) == pytest.approx(2 * window, abs=2)
        # 46 ms outlast 20 skipped cycles of 2 ms and three; the third heartbeat may be a period late
        assert value(0x1016, 1) == 127 << 16 | 69
        assert value(0x1017) == 23
        assert value(0x605A) == 2
        assert value(0x6007) == 3

    def test_objects_left_by_a_power_cut_are_restored_before_anything_else(self, drives: Cia402Cell) -> None:
        link = drives._link
        before = bytes(link.sdo(1).upload(0x6072, 0))
        energise(drives, [Mode.HOLD, Mode.HOLD])
        assert bytes(link.sdo(1).upload(0x6072, 0)) != before
        left_behind = Journal(None)
        for entry in drives.journal.entries:
            left_behind.add(entry)
        # power comes back: a new master on the same wire, with the old journal
        for node in (1, 2):
            link.nmt(0x80, node)
        drives.stop()
        again = Cia402Cell(link.bus, config(), journal=left_behind)
        again.check()
        assert bytes(link.sdo(1).upload(0x6072, 0)) == before
        assert left_behind.entries == ()

    def test_a_node_that_is_not_there_is_named_with_the_way_out(self, drives: Cia402Cell) -> None:
        cfg = config()
        wrong = cfg.model_copy(update={"axes": [cfg.axes[0], cfg.axes[1].model_copy(update={"node_id": 77})]})
        with pytest.raises(DriveError, match=r"A2: node 77 does not answer.*cable"):
            Cia402Cell(drives._link.bus, wrong).check()


def test_the_drives_own_windows_stand_around_where_the_axis_is_a_quarter_wider_than_the_masters() -> None:
    bus = foreign_bus()
    bus.axes[0].plant.q = 3.0  # an absolute encoder: the window is of 1 rad
    cell = Cia402Cell(bus, config())
    cell.check()
    energise(cell, [Mode.HOLD, Mode.HOLD])
    number, counts = bus.nodes[0].number, (1 << 16) / (2 * np.pi)
    found = [number(at) for at in (0x607D01, 0x607D02, 0x606500, 0x607F00)]
    assert found == pytest.approx([1.75 * counts, 4.25 * counts, 1.25 * counts, 12.5 * counts], abs=2)
    assert cell.close() == []


def test_an_axis_whose_direction_is_turned_moves_forward_under_positive_torque_all_the_same() -> None:
    bus = foreign_bus()
    cell = Cia402Cell(bus, config(direction=-1))
    cell.check()
    energise(cell, [Mode.TORQUE, Mode.HOLD])
    first = exchange(cell, [1.0, 0.0]).position[0]
    for _ in range(200):
        sample = exchange(cell, [1.0, 0.0])
    assert sample.position[0] - first == pytest.approx(0.5 * 0.4**2, rel=0.05)
    assert sample.torque[0] == pytest.approx(1.0)
    assert bus.axes[0].plant.q < 0
    assert cell.close() == []


@pytest.mark.parametrize(("limit", "outcome"), [(9, ""), (200, "meant"), (5000, "unit")])
def test_a_torque_limit_far_above_the_rated_one_is_asked_about_or_refused(limit: float, outcome: str) -> None:
    # rated 10 N·m: 200 N·m may be a peak that somebody knows of, 5000 cannot even be commanded
    cfg = config(limits={"torque_Nm": limit, "position_window_rad": 1.0, "velocity_rad_per_s": 10})
    cell = Cia402Cell(open_virtual_bus(cfg), cfg)
    if outcome == "unit":
        with pytest.raises(DriveError, match=r"A1.*torque_Nm is 5000, 500 times the rated 10 N·m.*unit"):
            cell.check()
    else:
        warnings = cell.check()[0].warnings
        assert any(outcome in w for w in warnings) if outcome else warnings == ()
    cell.close()


GAPS: list[tuple[set[int], dict[int, int], dict[str, Any], str]] = [
    ({0x6071}, {}, {}, "cannot be commanded"),
    ({0x6077}, {}, {}, "cannot be measured"),
    ({0x1016}, {}, {}, "allow_missing_heartbeat"),
    ({0x608F}, {}, {}, "position_rad_per_count"),
    ({0x6076}, {}, {}, "rated_torque_Nm"),
    (set(), {0x6076: 0}, {}, "rated_torque_Nm"),
    (set(), {0x6502: 0x41}, {}, "no torque mode"),
]


@pytest.mark.parametrize(("lacks", "values", "axis", "word"), GAPS)
def test_a_drive_that_cannot_do_the_job_is_refused_in_plain_words(
    lacks: set[int], values: dict[int, int], axis: dict[str, Any], word: str
) -> None:
    bus = foreign_bus(frozenset(lacks), values)
    with pytest.raises(DriveError, match=word) as caught:
        Cia402Cell(bus, config(**axis)).check()
    assert caught.value.exit_code == 5
    assert "A1" in str(caught.value)


def test_a_drive_in_fault_is_refused_and_not_reset() -> None:
    bus = foreign_bus()
    bus.axes[0].enter("fault", "found so")
    cell = Cia402Cell(bus, config())
    with pytest.raises(DriveError, match=r"A1.*in fault"):
        cell.check()
    cell.close()
    assert bus.axes[0].state == "fault"


WAYS_OUT: list[tuple[set[int], dict[int, int], dict[str, Any], str | None]] = [
    ({0x1016}, {}, {"allow_missing_heartbeat": True}, "0x1016"),
    ({0x608F}, {}, {"position_rad_per_count": 6e-6}, None),
    ({0x6076}, {}, {"rated_torque_Nm": 10.0}, None),
    ({0x6072}, {}, {}, "0x6072"),
    ({0x605A, 0x6007, 0x607D, 0x6065, 0x607F}, {}, {}, "0x605A"),
]


@pytest.mark.parametrize(("lacks", "values", "axis", "listed"), WAYS_OUT)
def test_a_gap_with_a_way_out_is_listed_and_the_drive_runs(
    lacks: set[int], values: dict[int, int], axis: dict[str, Any], listed: str | None
) -> None:
    cell = Cia402Cell(foreign_bus(frozenset(lacks), values), config(**axis))
    report = cell.check()[0]
    if listed is not None:
        assert any(listed in line for line in report.lacks)
    energise(cell, [Mode.HOLD, Mode.HOLD])
    assert all(exchange(cell, [0.0, 0.0]).fresh)
    assert cell.close() == []
    assert cell.not_off == ()


def test_a_cable_pulled_in_the_cycle_leaves_the_way_out_open() -> None:
    bus = foreign_bus()
    cell = Cia402Cell(bus, config())
    cell.check()
    energise(cell, [Mode.HOLD, Mode.HOLD])
    bus.nodes[1].is_mute, bus.nodes[1].hear = True, lambda *_: None  # type: ignore[method-assign]
    sample = exchange(cell, [0.0, 0.0])
    assert sample.fresh == [True, False]
    cell.stop()
    assert cell.not_off == ("A2",)
    assert bus.axes[0].state == "off"
    assert any("A2" in line and "not seen to switch off" in line for line in cell.close())


def test_a_bus_that_dies_is_an_error_of_the_bus_and_stop_still_returns() -> None:
    def dead(*_: Any) -> None:
        raise OSError(100, "Network is down")

    bus = foreign_bus()
    cell = Cia402Cell(bus, config())
    cell.check()
    energise(cell, [Mode.HOLD, Mode.HOLD])
    bus.send = dead  # type: ignore[method-assign]
    with pytest.raises(BusError, match="Network is down"):
        exchange(cell, [0.0, 0.0])
    cell.stop()
    cell.close()
    assert set(cell.not_off) == {"A1", "A2"}


def test_a_late_answer_to_the_cycles_question_is_not_taken_for_another_objects() -> None:
    cell = simulated()
    link = cell._link
    try:
        cell.check()
        # As the cycle does: ask for 0x6061 and do not wait. Its answer is under way at the next request.
        link.send(0x601, bytes.fromhex("4061600000000000"))
        position = link.sdo(1).upload(0x6064, 0)
        assert len(position) == 4
        link.send(0x601, bytes.fromhex("4061600000000000"))
        link.sdo(1).download(0x6071, 0, b"\0\0")
    finally:
        cell.close()


@pytest.mark.parametrize("late", [0.3, 1.2, 7.95])
def test_a_computer_that_wakes_late_skips_slots_and_never_sends_two_syncs_close_together(late: float) -> None:
    cell = simulated()
    link = cell._link
    sent: list[float] = []
    put, sleep_until = link.put, link.clock.sleep_until
    waits = 0

    def noted(message: Any) -> None:
        if message.arbitration_id == 0x80:
            sent.append(link.clock.now())
        put(message)

    def oversleep(instant: float) -> None:
        nonlocal waits
        waits += 1
        sleep_until(instant + (late * CYCLE if waits % 7 == 0 else 0.0))

    try:
        cell.check()
        energise(cell, held(cell))
        link.put, link.clock.sleep_until = noted, oversleep  # type: ignore[method-assign]
        slots = [exchange(cell, zero(cell)).slot for _ in range(200)]
        link.put, link.clock.sleep_until = put, sleep_until  # type: ignore[method-assign]
    finally:
        cell.close()
    assert len(sent) == 200
    assert np.diff(sent).min() > 0.49 * CYCLE
    # each SYNC belongs to the slot whose number its sample bears
    np.testing.assert_allclose(
        np.array(sent) - sent[0], (np.array(slots) - slots[0]) * CYCLE, atol=0.51 * CYCLE
    )
    assert np.all(np.diff(slots) >= 1)
    skipped = int((np.diff(slots) - 1).sum())
    assert skipped == (0 if late < 0.5 else cell._cycle.skipped_slots)
    assert (skipped > 0) == (late > 0.5)


def test_a_drive_with_one_sdo_buffer_gets_the_cycles_question_and_then_the_next_request() -> None:
    cell = simulated()
    link = cell._link
    put = link.put
    thinking_s, busy_until, lost = 0.02, 0.0, 0

    def one_buffer(message: Any) -> None:
        """A drive loses an SDO request that comes while it still works on the one before."""
        nonlocal busy_until, lost
        if message.arbitration_id == 0x601:
            if link.clock.now() < busy_until:
                lost += 1
                return
            busy_until = link.clock.now() + thinking_s
        put(message)

    try:
        cell.check()
        cell._link.bus.cell.drives[0].node._sdo_ns = round(thinking_s * 1e9)  # type: ignore[attr-defined]
        link.put = one_buffer  # type: ignore[method-assign]
        began = link.clock.now()
        link.ask(1, bytes.fromhex("4061600000000000"))
        link.ask(1, bytes.fromhex("4061600000000000"))  # not sent: the first is unanswered
        assert len(link.sdo(1).upload(0x6064, 0)) == 4
        assert lost == 0
        assert link.clock.now() - began < 3 * thinking_s
    finally:
        link.put = put  # type: ignore[method-assign]
        cell.close()


def freshness_of_a_moving_axis(meddle: Any) -> list[bool]:
    """A1 under constant torque, whose frames ``meddle(get)`` may hold back; what counts as fresh is true."""
    truth, _, _ = positions_of_a_moving_axis(simulated(), 100, lambda get: get)
    seen, fresh, slots = positions_of_a_moving_axis(simulated(), 60, meddle)
    step = max(np.abs(np.diff(truth)))
    assert all(abs(x - truth[k]) < 0.2 * step for x, k, new in zip(seen, slots, fresh, strict=True) if new)
    return fresh


def positions_of_a_moving_axis(
    cell: Cia402Cell, cycles: int, meddle: Any
) -> tuple[list[float], list[bool], list[int]]:
    """Position, freshness and slot of each cycle; the cell is closed then."""
    try:
        return _moving(cell, cycles, meddle)
    finally:
        cell.close()


def _moving(cell: Cia402Cell, cycles: int, meddle: Any) -> tuple[list[float], list[bool], list[int]]:
    cell.check()
    energise(cell, held(cell))
    set_modes(cell, [Mode.TORQUE, Mode.HOLD])
    assert cell.bounds is not None
    cell.bounds._most_missed = 1000  # what is believed is looked at, not what ends a run
    for _ in range(50):
        first = exchange(cell, [1.0, 0.0]).slot + 1
    cell._link.get = meddle(cell._link.get)  # type: ignore[method-assign]
    seen, fresh, slots = [], [], []
    for _ in range(cycles):
        sample = exchange(cell, [1.0, 0.0])
        seen.append(sample.position[0])
        fresh.append(sample.fresh[0])
        slots.append(sample.slot - first)
    return seen, fresh, slots


def test_tpdos_that_come_cycles_late_in_a_bunch_are_never_taken_for_a_later_cycles() -> None:
    """A simulated drive that was not run for a while answers all the SYNCs it missed at once."""
    calls = 0
    kept: list[Any] = []

    def meddle(get: Any) -> Any:
        def in_a_bunch(timeout: float) -> Any:
            """The tenth to fifteenth answers wait for the sixteenth; their order is kept."""
            nonlocal calls
            if kept and calls >= 16:
                return kept.pop(0)
            message = get(timeout)
            if message is None or message.arbitration_id != 0x181:
                return message
            calls += 1
            if 10 <= calls <= 16:
                kept.append(message)
                return in_a_bunch(timeout)
            return message

        return in_a_bunch

    fresh = freshness_of_a_moving_axis(meddle)
    assert 3 <= fresh.count(False) <= 12
    assert all(fresh[-30:])


def test_a_lost_tpdo_costs_its_own_cycle_and_no_other() -> None:
    calls = 0

    def meddle(get: Any) -> Any:
        def lossy(timeout: float) -> Any:
            nonlocal calls
            message = get(timeout)
            if message is not None and message.arbitration_id == 0x181:
                calls += 1
                if calls in (10, 30, 31):
                    return get(timeout)
            return message

        return lossy

    fresh = freshness_of_a_moving_axis(meddle)
    assert [k + 1 for k, new in enumerate(fresh) if not new] == [10, 30, 31]


class Behind:
    """A gateway that passes on A1's tenth to fortieth TPDO ``cycles`` later; none is lost."""

    def __init__(self, get: Any, clock: Any, cycles: float) -> None:
        self._get, self._clock, self._late = get, clock, cycles * CYCLE
        self._waiting: list[tuple[float, Any]] = []
        self._calls = 0

    def __call__(self, timeout: float) -> Any:
        end = self._clock.now() + timeout
        while True:
            now = self._clock.now()
            if self._waiting and self._waiting[0][0] <= now:
                return self._waiting.pop(0)[1]
            message = self._get(min(end, self._waiting[0][0] if self._waiting else end) - now)
            if message is not None and message.arbitration_id == 0x181:
                self._calls += 1
                late = self._late if 10 <= self._calls <= 40 else 0.0
                self._waiting.append(
                    (max(now + late, self._waiting[-1][0] if self._waiting else now), message)
                )
            elif message is not None:
                return message
            elif self._clock.now() >= end:
                return None


@pytest.mark.parametrize("cycles", [0.5, 1.0, 1.5, 3.3])
def test_a_drive_that_falls_behind_by_whole_cycles_and_stays_there_is_never_believed(cycles: float) -> None:
    """Its answers come as regularly as before, each in a later cycle than its own: one a cycle."""
    truth, _, _ = positions_of_a_moving_axis(simulated(), 150, lambda get: get)
    cell = simulated()
    clock = cell._link.clock
    seen, fresh, slots = positions_of_a_moving_axis(cell, 80, lambda get: Behind(get, clock, cycles))
    near = 0.2 * max(np.abs(np.diff(truth)))
    wrong = [k for x, k, new in zip(seen, slots, fresh, strict=True) if new and abs(x - truth[k]) > near]
    # the one sample that came alone and as fast as ever, before a slot without SYNC could tell
    assert len(wrong) <= 1
    assert all(fresh[:9])
    assert all(fresh[-15:])  # the gateway has caught up by then
    assert slots[-1] < 120


foreign_frames = st.builds(
    lambda can_id, data, length, extended, remote, error: can.Message(
        arbitration_id=can_id,
        data=None if remote else data,
        dlc=length if remote else len(data),
        is_extended_id=extended,
        is_remote_frame=remote,
        is_error_frame=error,
        check=False,
    ),
    # mostly identifiers that mean something: TPDO, SDO answer, EMCY, heartbeat of both nodes
    st.one_of(
        st.sampled_from([0x181, 0x182, 0x581, 0x582, 0x81, 0x82, 0x701, 0x702, 0x80]), st.integers(0, 0x7FF)
    ),
    st.binary(max_size=8),
    st.integers(0, 8),
    st.booleans(),
    st.booleans(),
    st.booleans(),
)


@settings(max_examples=15, deadline=None)
@given(st.lists(foreign_frames, min_size=1, max_size=60))
def test_frames_of_any_kind_in_the_cycle_never_crash_the_adapter_nor_keep_it_from_stopping(
    frames: list[can.Message],
) -> None:
    cell = simulated()
    get = cell._link.get
    waiting = list(frames)

    turn = 0

    def polluted(timeout: float) -> can.Message | None:
        """A strange frame between every two real ones."""
        nonlocal turn
        turn += 1
        return waiting.pop() if waiting and turn % 2 else get(timeout)

    try:
        cell.check()
        energise(cell, held(cell))
        cell._link.get = polluted  # type: ignore[method-assign]
        for _ in range(30):
            exchange(cell, zero(cell))
        cell.stop()
    except InvidError:
        cell.stop()
    finally:
        cell._link.get = get  # type: ignore[method-assign]
        bus: Any = cell._link.bus
        cell.close()
    assert all(d.state.name in ("SWITCH_ON_DISABLED", "READY_TO_SWITCH_ON", "FAULT") for d in bus.cell.drives)


def loaded(brake: str) -> Cia402Cell:
    """Two axes that 3 N·m pull down."""
    cfg = config({"effects": []}, gravity_loaded=True, brake=brake)
    return Cia402Cell(open_virtual_bus(cfg), cfg)


@pytest.mark.parametrize("brake", ["none", "drive"])
def test_a_gravity_loaded_axis_is_not_dropped_by_a_stop(brake: str) -> None:
    cell = loaded(brake)
    plant_cell: Any = cell._link.bus.cell  # type: ignore[attr-defined]
    plant = plant_cell.plant
    try:
        cell.check()
        energise(cell, held(cell))
        plant.external[plant.structure.motors] -= 3.0
        for _ in range(100):
            exchange(cell, zero(cell))
        before = plant.positions[plant.structure.motors].copy()
        cell.stop()
        states_after = [d.state.name for d in plant_cell.drives]
        cell._link.wait(1.0)
        fallen = np.abs(plant.positions[plant.structure.motors] - before)
    finally:
        said = cell.close()
    assert fallen.max() < 1e-3
    if brake == "none":
        assert states_after == ["QUICK_STOP_ACTIVE"] * 2
        assert cell.held_at_end == ("A1", "A2")
        assert any("A1" in line and "held" in line for line in said)
    else:
        assert states_after == ["SWITCH_ON_DISABLED"] * 2
        assert cell.held_at_end == ()
