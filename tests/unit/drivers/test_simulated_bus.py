"""The virtual-time bus: time, arbitration, wire times, determinism, python-can's promises."""

from __future__ import annotations

import struct
from pathlib import Path

import can
import pytest
import yaml

from invid.config import CellConfig
from invid_drivers.simulated import CASE_STUDY, VirtualTimeBus, open_virtual_bus


def config(**simulation: object) -> CellConfig:
    data = yaml.safe_load(CASE_STUDY.read_text(encoding="utf-8"))
    data["simulation"].update(simulation)
    return CellConfig.model_validate(data)


def message(can_id: int, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


READ_TYPE = bytes.fromhex("4000100000000000")


def test_time_stands_still_but_in_recv_and_sleep() -> None:
    with open_virtual_bus(config()) as bus:
        assert bus.clock.now() == 0.0
        bus.send(message(0x80))
        assert bus.clock.now() == 0.0
        bus.clock.sleep_until(0.5)
        assert bus.clock.now() == 0.5
        while bus.recv(0) is not None:
            pass
        assert bus.clock.now() == 0.5
        assert bus.recv(0.25) is None
        assert bus.clock.now() == 0.75


def test_an_answer_arrives_after_request_thinking_and_answer_have_been_on_the_wire() -> None:
    with open_virtual_bus(config()) as bus:
        bus.clock.sleep_until(0.1)
        while bus.recv(0):
            pass
        bus.send(message(0x601, READ_TYPE))
        answer = bus.recv(1.0)
        assert answer is not None
        assert answer.arbitration_id == 0x581
        assert struct.unpack_from("<I", answer.data, 4) == (0x00020192,)
        assert answer.timestamp == pytest.approx(0.1 + 135e-6 + 200e-6 + 135e-6, abs=1e-9)


def test_the_lowest_identifier_wins_but_a_masters_queue_keeps_its_order() -> None:
    with open_virtual_bus(config()) as bus, can.Bus(interface="invid-virtual", channel="case-study") as spy:
        assert isinstance(spy, VirtualTimeBus)
        bus.clock.sleep_until(0.1)
        while spy.recv(0):
            pass
        for node in (3, 1):  # both answers are due while the wire is busy with 0x7FF
            bus.send(message(0x600 + node, READ_TYPE))
        for _ in range(4):
            bus.send(message(0x7FF, bytes(8)))
        bus.send(message(0x10))
        bus.clock.sleep_until(0.2)
        order = []
        while (frame := spy.recv(0)) is not None:
            order.append(frame.arbitration_id)
        # the master's 0x10 stands behind its own 0x7FF; the nodes' answers come in between
        assert order[:2] == [0x603, 0x601]
        assert order.index(0x583) < 5
        assert order[-1] == 0x10


def test_bus_off_of_the_master_is_seen_in_send_recv_and_state() -> None:
    fault = {"kind": "bus_off", "at_s": 0.05, "duration_s": 0.05}
    with open_virtual_bus(config(faults=[fault])) as bus:
        bus.clock.sleep_until(0.0499)
        for _ in range(5):
            bus.send(message(0x601, READ_TYPE))
        bus.clock.sleep_until(0.06)
        assert bus.cell.frames_in < 5  # what was waiting is gone
        while (frame := bus.recv(0.0)) is not None and not frame.is_error_frame:
            pass
        assert frame is not None
        assert bus.state is can.BusState.ERROR
        with pytest.raises(can.CanOperationError, match="bus-off"):
            bus.send(message(0x80))
        bus.clock.sleep_until(0.11)
        assert bus.state is can.BusState.ACTIVE
        bus.send(message(0x80))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"plnt": {}}, "plnt"),
        ({"axes": {"A9": {}}}, "no axis 'A9'"),
        ({"plant": {"branches": [{"axis": "A1", "masses": [1.0]}]}}, "one branch per axis"),
        ({"plant": {}}, "either case_study"),
        (
            {
                "plant": {
                    "branches": [
                        {"axis": "A1", "masses": [1.0, 1e-6], "springs": [1e9]},
                        {"axis": "A2", "masses": [1.0]},
                        {"axis": "A3", "masses": [1.0]},
                    ]
                }
            },
            "softer springs",
        ),
        ({"faults": [{"kind": "drop"}]}, "at_s or at_state"),
        ({"faults": [{"kind": "push", "at_s": 1}]}, "give the axis"),
        ({"faults": [{"kind": "mode_display", "at_s": 1, "axis": "A1", "value": 988}]}, "no mode"),
        ({"defaults": {"torque_noise": -1}}, "torque_noise"),
        ({"defaults": {"objects": {"profile": "acme"}}}, "unknown profile"),
        ({"defaults": {"objects": {"lacks": ["torque"]}}}, "is no object"),
        (
            {"effects": [{"cause": "torque_delay", "axis": "A1", "parameters": {"delay": -0.001}}]},
            "before its command",
        ),
        (
            {"effects": [{"cause": "payload_change", "axis": "A1", "parameters": {"mass": -2.9, "time": 1}}]},
            "not positive definite",
        ),
        ({"effects": [{"cause": "magic", "axis": "A1"}]}, "unknown cause"),
    ],
)
def test_a_wrong_simulation_section_is_refused_in_plain_words(change: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        open_virtual_bus(config(**change))


def log_of_a_run() -> list[tuple[float, int, bytes]]:
    """Half a second of everything: SDO, shaking, noise, lost frames, a node reset."""
    faults = [
        {"kind": "drop", "at_s": 0.1, "rate": 0.1, "axis": "A1"},
        {"kind": "corrupt", "at_s": 0.1, "rate": 0.1, "axis": "A2"},
        {"kind": "delay", "at_s": 0.1, "rate": 0.2, "delay_s": 0.0007},
        {"kind": "node_reset", "at_s": 0.35, "axis": "A3"},
    ]
    with open_virtual_bus(config(faults=faults)) as bus:
        log = []
        bus.clock.sleep_until(0.01)
        for node in (1, 2, 3):
            for head, data in (
                (0x1800, (0x80000180 + node, 1)),
                (0x1A00, (0, 0)),
                (0x1A00, (0x60640020, 1)),
                (0x1A00, (0x60770010, 2)),
                (0x1A00, (2, 0)),
                (0x1800, (1, 2)),
                (0x1800, (0x180 + node, 1)),
                (0x6060, (10, 0)),
            ):
                value, sub = data
                size = {0x6060: 1}.get(head, 1 if sub in (0, 2) and value < 256 else 4)
                first = 0x23 | (4 - size) << 2
                bus.send_raw(0x600 + node, struct.pack("<BHBI", first, head, sub, value))
                log.append(bus.recv_raw(0.1))
        bus.send_raw(0, b"\x01\x00")
        for k in range(400):
            bus.clock.sleep_until(0.1 + k * 0.001)
            bus.send_raw(0x80, b"")
            for node in (1, 2, 3):
                bus.send_raw(0x200 + node, struct.pack("<H", (6, 7, 15)[min(k // 5, 2)]))
            while (frame := bus.recv_raw(0)) is not None:
                log.append(frame)
        return log


def test_two_runs_give_bit_identical_logs() -> None:
    first, second = log_of_a_run(), log_of_a_run()
    assert len(first) > 1000
    assert first == second


def test_the_section_in_the_docs_is_a_cell_that_runs() -> None:
    text = (Path(__file__).parents[3] / "docs/explanations/simulated-cell.md").read_text(encoding="utf-8")
    section = yaml.safe_load(text.split("```yaml\n")[1].split("```")[0])
    data = yaml.safe_load(CASE_STUDY.read_text(encoding="utf-8"))
    data["axes"] = data["axes"][:2]
    data.update(section)
    with open_virtual_bus(CellConfig.model_validate(data)) as bus:
        bus.clock.sleep_until(7.0)
        assert bus.cell.drive("A2").node.od.find(0x6072) is None  # as the profile says
