"""The virtual-time bus: time, arbitration, wire times, determinism, python-can's promises."""

from pathlib import Path

import can
import pytest
import yaml

from invid.config import CellConfig
from invid_drivers.simulated import CASE_STUDY, open_virtual_bus


def config(**simulation: object) -> CellConfig:
    data = yaml.safe_load(CASE_STUDY.read_text(encoding="utf-8"))
    data["simulation"].update(simulation)
    return CellConfig.model_validate(data)


def message(can_id: int, data: bytes = b"") -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False)


READ_TYPE = bytes.fromhex("4000100000000000")


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


def test_the_section_in_the_docs_is_a_cell_that_runs() -> None:
    text = (Path(__file__).parents[3] / "docs/explanations/simulated-cell.md").read_text(encoding="utf-8")
    section = yaml.safe_load(text.split("```yaml\n")[1].split("```")[0])
    data = yaml.safe_load(CASE_STUDY.read_text(encoding="utf-8"))
    data["axes"] = data["axes"][:2]
    data.update(section)
    with open_virtual_bus(CellConfig.model_validate(data)) as bus:
        bus.clock.sleep_until(7.0)
        assert bus.cell.drive("A2").node.od.find(0x6072) is None  # as the profile says
