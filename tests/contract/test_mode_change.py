"""Changes of mode with drives that take their time: SYNC goes on, and so does every loop. Judged on the
frames on the wire, and on the plant."""

import struct
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from stepping import energise, exchange, set_modes
from test_adapter_promises import config, held, zero
from test_way_out import exchanged

from invid.config import CellConfig
from invid.errors import DriveError
from invid.planning import make_plan
from invid.sweep import Mode
from invid_drivers.cia402 import objects as od
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.cia402.cycle_requests import NOT_NOW, Change
from invid_drivers.cia402.cycle_time import interpolation_time
from invid_drivers.cia402.objects import NodeAxis
from invid_drivers.cia402.states import OperationMode
from invid_drivers.measurement import run_measurement
from invid_drivers.simulated import VirtualTimeBus, open_virtual_bus

ENERGISED = {"OPERATION_ENABLED", "QUICK_STOP_ACTIVE", "FAULT_REACTION_ACTIVE"}
CYCLE = 0.002


class Wire:
    """When SYNC was sent, and whether any axis was energised then; who carried which torque."""

    def __init__(self, bus: VirtualTimeBus) -> None:
        self.syncs: list[tuple[float, bool]] = []
        self.beats: list[float] = []
        self.torque: dict[int, list[tuple[float, int]]] = {}
        self._bus, self._send = bus, bus.send
        bus.send = self  # type: ignore[method-assign,assignment]

    def __call__(self, msg: can.Message, timeout: float | None = None) -> None:
        now = self._bus.clock.now()
        if msg.arbitration_id == 0x80:
            self.syncs.append((now, any(d.state.name in ENERGISED for d in self._bus.cell.drives)))
        elif msg.arbitration_id == 0x77F:
            self.beats.append(now)
        elif msg.arbitration_id & 0x780 == 0x200:
            value = int.from_bytes(msg.data[2:4], "little", signed=True)
            self.torque.setdefault(msg.arbitration_id & 0x7F, []).append((now, value))
        self._send(msg, timeout)

    @property
    def longest_gap(self) -> float:
        """In cycles, between two SYNCs with an energised axis at the first, but for the silences of the stop
        test, in which the heartbeat is missing, too."""
        pairs = zip(self.syncs, self.syncs[1:], strict=False)
        gaps = [(before, after) for (before, on), (after, _) in pairs if on]
        spoken = [
            after - before for before, after in gaps if after - before < 0.05 or self._beats_in(before, after)
        ]
        return max(spoken) / CYCLE

    def _beats_in(self, before: float, after: float) -> bool:
        return any(before < at < after - CYCLE for at in self.beats)


def slow(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    return {
        "axes": {
            name: {
                "sdo_response_s": float(rng.uniform(0.05, 0.2)),
                "mode_change_s": float(rng.uniform(0.0, 0.4)),
                "mode_display_s": float(rng.uniform(0.0, 0.4)),
                "rated_torque_Nm": 10,
                "encoder_counts_per_rev": 1 << 20,
            }
            for name in ("A1", "A2")
        }
    }


def small(cfg: CellConfig) -> CellConfig:
    data = cfg.model_dump(mode="json", exclude_none=True, by_alias=True)
    data["experiments"] = [
        {"kind": "multisine", "band_Hz": [2, 12], "period_s": 1.024, "periods": 1, "settle_periods": 0,
         "experiments": 1}
    ]  # fmt: skip
    data["safety"] = {"missed_tpdos": 5, "overrun_cycles": 5}
    return CellConfig.model_validate(data)


@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.campaign) for s in (1, 2))])
def test_a_measurement_on_slow_drives_never_leaves_an_energised_axis_without_sync_for_three_cycles(
    seed: int, tmp_path: Path
) -> None:
    cfg = small(config(slow(seed)))
    bus = open_virtual_bus(cfg)
    wire = Wire(bus)
    plan = make_plan(cfg)
    result = run_measurement(cfg, plan, Cia402Cell(bus, cfg), tmp_path / "run.h5")
    assert str(result.outcome) == "completed"
    assert wire.longest_gap <= 3
    assert max(p["travel"] for p in result.peaks.values()) < 1.0


def test_while_one_drive_takes_its_time_every_axis_in_torque_mode_follows_its_own_loop() -> None:
    cfg = config(slow(1))
    bus = open_virtual_bus(cfg)
    cell = Cia402Cell(bus, cfg)
    wire = Wire(bus)
    plant = bus.cell.plant
    try:
        cell.check()
        energise(cell, held(cell))
        set_modes(cell, [Mode.TORQUE, Mode.HOLD])
        while cell.changing:
            exchange(cell, zero(cell))
        set_modes(cell, [Mode.TORQUE, Mode.TORQUE])
        began, sent = bus.clock.now(), 0
        motors = plant.structure.motors
        while cell.changing:
            sample = exchange(cell, [-20.0 * (cell._cycle.sample.position[0] - 0.05), 0.3])
            sent += 1
        took = bus.clock.now() - began
        assert took > 0.3
        assert sent == pytest.approx(took / CYCLE, abs=2)
        torques = [value for when, value in wire.torque[1] if when > began]
        assert len(set(torques)) > 50  # a loop, not one torque held
        assert {value for when, value in wire.torque[2] if when > began} == {30}
        # it is in torque mode when it says so, and moves by what was sent
        assert plant.positions[motors[1]] > 0
        assert sample.fresh == [True, True]
        set_modes(cell, held(cell))
        x = list(sample.position)
        began = bus.clock.now()
        while cell.changing:  # axis 1 under the damping of its own loop, axis 2 too, until each is held
            speed = [(now - last) / CYCLE for now, last in zip(cell._cycle.sample.position, x, strict=True)]
            x = list(cell._cycle.sample.position)
            exchange(cell, [-10.0 * v for v in speed])
        assert bus.clock.now() - began > 0.3
        before = plant.positions[motors].copy()
        for _ in range(200):
            exchange(cell, [0.0, 0.0])
        assert np.abs(plant.velocities[motors]).max() < 1e-3
        assert np.abs(plant.positions[motors] - before).max() < 0.02
        assert wire.longest_gap <= 3
    finally:
        assert cell.close() == []


@pytest.mark.parametrize("silent", [True, False])
def test_a_drive_that_does_not_change_its_mode_ends_the_measurement_by_name_and_nobody_waits_for_it(
    silent: bool,
) -> None:
    cfg = config()
    bus = open_virtual_bus(cfg)
    cell = Cia402Cell(bus, cfg)
    wire = Wire(bus)
    try:
        cell.check()
        energise(cell, held(cell))
        drive = bus.cell.drives[1]
        if silent:
            drive.node._sdo.answer = lambda request: None  # type: ignore[method-assign]
        else:
            drive.mode_lie = 8
        set_modes(cell, [Mode.HOLD, Mode.TORQUE])
        with pytest.raises(DriveError, match=f"axis A2.*{'does not answer' if silent else 'shows mode 8'}"):
            exchanged(cell, 3000)
        assert wire.longest_gap <= 3
    finally:
        cell.close()


@pytest.mark.parametrize(
    ("cycle", "expected"),
    [(0.001, (1, -3)), (0.0005, (5, -4)), (0.00025, (25, -5)), (0.004, (4, -3)), (1 / 3000, None)],
)
def test_the_interpolation_time_is_the_cycle_exactly_or_not_written(
    cycle: float, expected: tuple[int, int] | None
) -> None:
    assert interpolation_time(cycle) == expected


def test_a_mode_that_the_drive_refuses_is_named() -> None:
    cfg = config()
    bus = open_virtual_bus(cfg)
    cell = Cia402Cell(bus, cfg)
    try:
        cell.check()
        energise(cell, held(cell))
        bus.cell.drives[0].node.od.put(0x6502, 0, 1 << 7)
        set_modes(cell, [Mode.TORQUE, Mode.HOLD])
        with pytest.raises(DriveError, match=r"axis A1.*0x6060 mode of operation was refused"):
            exchanged(cell, 100)
    finally:
        cell.close()


def test_a_load_whose_drive_takes_a_mode_without_power_only_is_refused_with_every_way_out() -> None:
    change = Change(NodeAxis(1), [od.MODE, od.MODE_DISPLAY], int(OperationMode.CYCLIC_TORQUE), 0.0)
    change.answered(struct.pack("<BHBI", 0x80, 0x6060, 0, NOT_NOW), 0.01)
    said = change.failure(0.02)
    assert said is not None
    assert all(w in said for w in ("brake: drive", "unload", "in_closed_loop: true", "0x60B2"))
