"""Drives without a torque mode, shaken by their torque offset while their own loops stay closed."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from stepping import energise, exchange, set_modes

from invid.config import CellConfig, parse_config
from invid.errors import ConfigError, DriveError, SafetyStop
from invid.identification.identify import identify
from invid.recording import read_recording
from invid.sweep import Mode
from invid_drivers.connect import connect
from invid_drivers.measurement import measure_to_file
from invid_drivers.readiness import ask

MULTISINE = {"kind": "multisine", "band_Hz": [1, 30], "period_s": 2.048, "periods": 4}


def cell(*, vendor: str = "generic", faults: Any = (), experiments: Any = None, **objects: Any) -> CellConfig:
    limits = {"torque_Nm": 25, "position_window_rad": 0.5, "velocity_rad_per_s": 3, "stopping_room_rad": 3}
    names = ("A1", "A2")
    return parse_config(
        yaml.safe_dump(
            {
                "format": "invid-config",
                "robot": "no torque mode",
                "bus": {"interface": "invid-virtual", "channel": "offset"},
                "axes": [
                    {"name": n, "node_id": i, "rated_torque_Nm": 50, "masses": 2, "inertia_kgm2": 3.0,
                     "gravity_loaded": False, "limits": limits, "vendor": vendor}
                    for i, n in enumerate(names, 1)
                ],
                "safety": {"heartbeat_s": 0.03},
                "experiments": experiments
                or [MULTISINE, {**MULTISINE, "periods": 2, "role": "validate", "experiments": 1}],
                "simulation": {
                    "plant": {
                        "branches": [
                            {"axis": "A1", "masses": [1.0, 2.0], "springs": [1500], "dampers": [1.0]},
                            {"axis": "A2", "masses": [1.2, 1.8], "springs": [2500], "dampers": [1.0]},
                        ],
                        "couplings": [{"between": ["A1", "A2"], "value": 0.3}],
                    },
                    "defaults": {
                        "torque_noise_fraction_of_rated": 0.002, "position_loop_Hz": 8,
                        "objects": {"lacks": ["0x6071", "0x6087"], "values": {"0x6502": 0x80}} | objects,
                    },
                    "faults": list(faults),
                },
            }
        )
    )  # fmt: skip


@pytest.mark.campaign
def test_the_whole_job_on_drives_that_never_leave_cyclic_position(tmp_path: Path) -> None:
    result = measure_to_file(cell(), tmp_path / "run.h5")
    assert any("torque offset (0x60B2)" in w for w in result.warnings)
    recording = read_recording(tmp_path / "run.h5")
    assert all(np.isnan(e.hold_gain).all() for e in recording.experiments)
    model = identify(recording)
    found, std = model.chains, model.std
    for i, (masses, spring) in enumerate((([1.0, 2.0], 1500.0), ([1.2, 1.8], 2500.0))):
        assert abs(found.masses[i][1] - masses[1]) <= 4 * std.masses[i][1]
        # the loop's torque is recorded up to a cycle late: its damping times that is a mass at the motor
        damping = 1.4 * 2 * np.pi * 8 * masses[0]
        assert abs(found.masses[i][0] - masses[0]) <= damping * 0.0006
        assert float(found.springs[i][0]) == pytest.approx(spring, rel=0.005)
    assert float(found.couplings[0, 1]) == pytest.approx(0.3, rel=0.01)


def test_the_offset_takes_the_place_of_the_target_and_its_drive_goes_on_holding() -> None:
    master = connect(cell())
    bus: Any = master.link.bus
    (first, second) = master.check()
    assert first.by_offset
    assert second.by_offset
    energise(master, [Mode.HOLD, Mode.HOLD])
    drive = bus.cell.drives[0]
    assert drive.node.od.number(0x1600, 2) == 0x60B20010
    assert drive.mode == 8
    set_modes(master, [Mode.TORQUE, Mode.HOLD])
    assert not master.changing
    for _ in range(300):
        sample = exchange(master, [5.0, 5.0])
    # 5 N·m against a loop of 8 Hz on the motor's 1 kg·m²; the held axis is sent nothing
    assert sample.position[0] == pytest.approx(5.0 / (2 * np.pi * 8) ** 2, rel=0.2)
    assert abs(sample.position[1]) < 1e-4
    assert drive.mode == 8
    assert master.close() == []
    assert drive.node.od.number(0x1600, 2) != 0x60B20010


@pytest.mark.parametrize("signal", ["torque", "encoder"])
def test_a_wrong_sign_behind_a_closed_loop_is_found_before_full_amplitude(
    signal: str, tmp_path: Path
) -> None:
    fault = {"kind": "sign_flip", "axis": "A1", "at_s": 0.0, "signal": signal}
    with pytest.raises((SafetyStop, DriveError), match="A1"):
        measure_to_file(cell(faults=[fault]), tmp_path / "run.h5")
    assert not (tmp_path / "run.h5").exists()


def test_a_path_that_such_a_drive_cannot_be_led_along_is_refused_with_the_way_out() -> None:
    path = {"kind": "constant_velocity", "velocities_rad_per_s": [0.1], "travel_rad": 0.1, "axes": ["A1"]}
    with pytest.raises(
        ConfigError, match=r"constant_velocity.*A1.*torque offset only.*cyclic synchronous torque"
    ):
        ask(cell(experiments=[MULTISINE, path])).require()


@pytest.mark.parametrize(
    ("vendor", "objects"),
    [
        ("pilz", {}),
        ("schunk", {}),
        ("generic", {"lacks": ["0x6071", "0x60B2"], "values": {"0x6502": 0x80}}),
        ("generic", {"lacks": ["0x6071"], "values": {"0x6502": 0x43}}),
    ],
)
def test_a_drive_that_takes_no_offset_is_refused_as_before(vendor: str, objects: dict[str, Any]) -> None:
    master = connect(cell(vendor=vendor, **objects))
    with pytest.raises(DriveError, match=r"A1.*0x6071.*invid import"):
        master.check()
    master.close()
