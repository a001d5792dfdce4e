"""Injected faults do what they say; garbage on the bus never breaks a node."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from node_master import Master, case_study_cell, cell

from invid_drivers.simulated.faults import DRIVE_FAULTS, FRAME_FAULTS

OE, FAULT, QSA, SOD = 0x27, 0x08, 0x07, 0x40


def run(fault: dict[str, Any], cycles: int, target: int = 100, word: int = 0x0F, mode: int = 10) -> Any:
    """Enabled, then ``cycles`` with a torque; the fault comes 50 ms after enabling."""
    when = {} if "at_s" in fault else {"at_state": "operation_enabled", "after_s": 0.05}
    master = Master(cell({"faults": [{"axis": "A1", **when, **fault}]}))
    master.prepare(mode=mode)
    master.enable()
    log = [master.cycle([target], word).get(1) for _ in range(cycles)]
    return master, log


def test_a_rate_of_lost_frames_loses_about_that_many() -> None:
    master, log = run({"kind": "drop", "rate": 0.1, "can_ids": [0x181]}, 2000, target=0)
    lost = sum(entry is None for entry in log)
    assert 140 < lost < 260  # 195 expected, standard deviation 13
    master.close()


def test_a_burst_loses_exactly_its_count() -> None:
    master, log = run({"kind": "drop", "count": 7, "can_ids": [0x181]}, 200, target=0)
    lost = [k for k, entry in enumerate(log) if entry is None]
    assert len(lost) == 7
    assert lost == list(range(lost[0], lost[0] + 7))
    master.close()


def test_duplicated_delayed_and_corrupted_frames_arrive_so() -> None:
    master, _ = run({"kind": "duplicate", "can_ids": [0x181], "duration_s": 0.1}, 60, target=0)
    master.wait(0.001)
    master.bus.send_raw(0x80, b"")
    frames = [f for f in master.wait(0.002) if f[1] == 0x181]
    assert len(frames) == 2
    assert frames[0][2] == frames[1][2]
    master.close()
    master, _ = run({"kind": "delay", "can_ids": [0x181], "delay_s": 0.0004}, 60, target=0)
    sent = master.bus.clock.now()
    master.bus.send_raw(0x80, b"")
    frames = [f for f in master.wait(0.002) if f[1] == 0x181]
    # SYNC 55 µs, the delay, 8 bytes 135 µs
    assert frames[-1][0] - sent == pytest.approx(0.0004 + 190e-6, abs=2e-6)
    master.close()
    master, log = run({"kind": "corrupt", "can_ids": [0x181], "rate": 0.5}, 300, target=0)
    assert any(abs(entry[0]) > 1000 for entry in log[60:] if entry)
    master.close()


def test_a_reset_node_boots_disabled() -> None:
    master, log = run({"kind": "node_reset"}, 100)
    assert log[30] is not None
    assert log[-1] is None  # pre-operational: no PDO
    assert (0x701, b"\0") in [(i, d) for _, i, d in master.other]
    assert master.read(1, 0x6041, 0, "H") & 0x6F == SOD
    master.wait(0.5)
    assert abs(float(master.bus.cell.plant.velocities[0])) < 1e-9  # the brake has fallen in
    master.close()


def test_a_node_whose_cable_is_pulled_stops_by_its_own_heartbeat_watch() -> None:
    master = Master(
        cell(
            {
                "faults": [
                    {"kind": "node_silent", "axis": "A1", "at_state": "operation_enabled", "after_s": 0.05}
                ]
            }
        )
    )
    assert master.write(1, 0x1016, 1, "I", 127 << 16 | 30) == 0
    master.prepare()
    master.bus.send_raw(0x77F, b"\x05")
    master.enable()
    for _ in range(400):
        answers = master.cycle([100], 0x0F)
        master.bus.send_raw(0x77F, b"\x05")
    assert not answers
    assert master.bus.cell.drives[0].state.name == "FAULT"
    assert abs(float(master.bus.cell.plant.velocities[0])) < 1e-9
    master.close()


def test_a_drive_that_ignores_quick_stop_goes_on_and_obeys_disable_voltage() -> None:
    master, _ = run({"kind": "ignore_quick_stop"}, 60)
    for _ in range(50):
        answers = master.cycle([100], 0x02)
    assert answers[1][2] & 0x6F == OE
    for _ in range(5):
        answers = master.cycle([100], 0x00)
    assert answers[1][2] & 0x6F == SOD
    master.close()


def test_encoder_jump_and_stuck_encoder() -> None:
    master, log = run({"kind": "encoder_jump", "counts": 5000}, 100, target=0)
    assert [log[20][0], log[-1][0]] == [0, 5000]
    master.close()
    master, log = run({"kind": "encoder_stuck"}, 120)
    assert len({entry[0] for entry in log[-50:]}) == 1
    assert float(master.bus.cell.plant.positions[0]) > 2 * log[-1][0] * 6.2832 / 524288 > 0
    master.close()


@pytest.mark.parametrize("signal", ["torque", "encoder"])
def test_a_flipped_sign_turns_acceleration_around(signal: str) -> None:
    fault = {"kind": "sign_flip", "signal": signal, "at_s": 0.0}
    master, log = run(fault, 100)
    assert log[-1][0] < -1000  # 10 N·m on 1 kg·m² for 0.1 s: 0.05 rad, 4172 counts
    assert log[-1][1] == 100  # the drive believes its torque
    master.close()


def test_a_brake_that_does_not_open_holds_the_axis() -> None:
    master, log = run({"kind": "brake_stuck", "at_s": 0.0}, 200, target=1500)  # 150 of 200 N·m
    assert log[-1][:2] == (0, 1500)
    master.close()


def test_torque_saturation_acts_and_is_not_reported() -> None:
    master, log = run({"kind": "torque_saturation", "limit_Nm": 4.0, "at_s": 0.0}, 100)
    assert log[-1][1] == 100
    expected = 0.5 * 4.0 * 0.1**2  # 4 N·m on 1 kg·m² for a tenth of a second
    assert log[-1][0] * 6.283185 / 524288 == pytest.approx(expected, rel=0.05)
    master.close()


def test_lies_of_statusword_and_mode_display() -> None:
    master, log = run({"kind": "statusword", "value": 0x0218}, 100, target=0)
    assert log[-1][2] == 0x0218
    master.close()
    master, _ = run({"kind": "mode_display", "value": 8}, 100, target=0)
    assert master.read(1, 0x6061, 0, "b") == 8
    master.close()


def test_every_kind_of_fault_can_happen_in_a_run_of_three_axes() -> None:
    for number, kind in enumerate((*FRAME_FAULTS, *DRIVE_FAULTS)):
        fault = {
            "kind": kind,
            "axis": "A2",
            "at_s": 0.06,
            "duration_s": 0.03,
            "limit_Nm": 1.0,
            "torque_Nm": 5.0,
        }
        master = Master(case_study_cell(seed=number, faults=[fault]))
        master.prepare()
        for word in [6, 6, 7, 7, *[0x0F] * 60]:
            master.cycle([100, 0, 0], word)
        assert np.isfinite(master.bus.cell.plant.state).all(), kind
        master.close()


@settings(max_examples=60, deadline=None)
@given(
    frames=st.lists(
        st.tuples(
            st.integers(0, 0x7FF) | st.sampled_from([0, 0x80, 0x201, 0x301, 0x601, 0x77F]),
            st.binary(max_size=8),
        ),
        max_size=40,
    )
)
def test_random_frames_never_break_a_node(frames: list[tuple[int, bytes]]) -> None:
    master = Master(cell(axes=2))
    try:
        assert master.write(1, 0x1016, 1, "I", 0x7F0064) == 0
        master.bus.send_raw(0, b"\x01\x00")
        for can_id, data in frames:
            master.bus.send_raw(can_id, data)
            master.wait(0.0005)
        master.bus.send_raw(0, b"\x81\x00")  # reset: whatever it was in, it comes back
        master.wait(0.1)
        assert master.read(1, 0x1000) == 0x00020192
        assert np.isfinite(master.bus.cell.plant.state).all()
    finally:
        master.close()


@settings(max_examples=40, deadline=None)
@given(
    requests=st.lists(
        st.tuples(
            st.sampled_from(
                [0x20, 0x21, 0x22, 0x23, 0x27, 0x2B, 0x2F, 0x40, 0x60, 0x70, 0x80, 0x00, 0x10, 0x01]
            ),
            st.sampled_from(
                [
                    *range(0x1000, 0x1020),
                    *range(0x1400, 0x1404),
                    *range(0x1600, 0x1604),
                    0x1800,
                    0x1A00,
                    *range(0x6040, 0x60C4),
                    0x6502,
                ]
            ),
            st.integers(0, 9),
            st.binary(min_size=4, max_size=4),
        ),
        max_size=30,
    )
)
def test_random_object_accesses_never_break_a_node(requests: list[tuple[int, int, int, bytes]]) -> None:
    master = Master(cell())
    try:
        for command, index, sub, data in requests:
            master.bus.send_raw(0x601, struct.pack("<BHB", command, index, sub) + data)
            master.bus.send_raw(0x80, b"")
            master.bus.send_raw(0, b"\x01\x00")
            master.wait(0.002)
        master.bus.send_raw(0, b"\x81\x00")
        master.wait(0.1)
        assert master.read(1, 0x1000) == 0x00020192
    finally:
        master.close()
