"""What a drive says of itself is heard before full amplitude, and named: statusword, 0x6077, 0x1000."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from invid.config import CellConfig, parse_config
from invid.errors import DriveError, SafetyStop
from invid.planning import make_plan
from invid.sweep import Progress
from invid_drivers.connect import connect
from invid_drivers.measurement import run_measurement


def cell(*faults: dict[str, Any], **axis: Any) -> CellConfig:
    limits = {"torque_Nm": 25, "position_window_rad": 0.5, "velocity_rad_per_s": 3, "stopping_room_rad": 3}
    names = ("A1", "A2")
    return parse_config(
        yaml.safe_dump(
            {
                "format": "invid-config",
                "robot": "two axes",
                "bus": {"interface": "invid-virtual", "channel": "says", "cycle_s": 0.004},
                "axes": [
                    {"name": n, "node_id": i, "rated_torque_Nm": 50, "inertia_kgm2": 2, "limits": limits}
                    | axis
                    for i, n in enumerate(names, 1)
                ],
                "safety": {"heartbeat_s": 0.03},
                "experiments": [
                    {"kind": "multisine", "band_Hz": [2, 12], "period_s": 1.024, "periods": 2,
                     "settle_periods": 0, "experiments": 1}
                ],
                "simulation": {
                    "plant": {
                        "branches": [{"axis": n, "masses": [1.5, 0.5], "springs": [2000.0]} for n in names]
                    },
                    "faults": list(faults),
                },
            }
        )
    )  # fmt: skip


def run(config: CellConfig, out: Path, at: str = "", then: Any = None) -> tuple[list[str], Any]:
    """A measurement: the phases it came to, and its result; ``then`` is done to the first drive."""
    phases: list[str] = []
    master = connect(config)
    bus: Any = master.link.bus
    drive = bus.cell.drives[0]

    def progress(p: Progress) -> None:
        if then is not None and at in p.phase and p.phase not in phases:
            then(drive)
        phases.append(p.phase)

    try:
        return phases, run_measurement(config, make_plan(config), master, out, progress=progress)
    except (SafetyStop, DriveError) as error:
        return phases, error
    finally:
        assert all(d.state.name in ("SWITCH_ON_DISABLED", "FAULT") for d in bus.cell.drives)


def test_a_healthy_drive_says_nothing(tmp_path: Path) -> None:
    _, result = run(cell(), tmp_path / "run.h5")
    assert not [w for w in result.warnings if "statusword" in w]


def test_a_drive_that_limits_is_named_before_full_amplitude(tmp_path: Path) -> None:
    def derate(drive: Any) -> None:
        drive.node.od.put(0x6072, 0, 5)  # a drive that is hot gives 0.25 N·m

    phases, error = run(cell(), tmp_path / "run.h5", "settling", derate)
    assert isinstance(error, SafetyStop)
    assert re.search(r"A1.*limits \(statusword bit 11\).*0x6072", str(error))
    assert not any("experiment" in p for p in phases)


def test_a_drive_that_limits_at_full_amplitude_alone_is_named_in_the_result(tmp_path: Path) -> None:
    def derate(drive: Any) -> None:
        drive.node.od.put(0x6072, 0, 60)

    _, result = run(cell(), tmp_path / "run.h5", "experiment", derate)
    assert not isinstance(result, Exception), result
    (said,) = [w for w in result.warnings if "statusword" in w]
    assert re.search(r"A1.*limits \(statusword bit 11\) in \d+%", said)


def test_a_drive_that_no_longer_follows_its_target_is_named(tmp_path: Path) -> None:
    def ignore(drive: Any) -> None:
        drive.ignore_target = True

    _, error = run(cell(), tmp_path / "run.h5", "experiment", ignore)
    assert isinstance(error, SafetyStop)
    assert re.search(r"A1.*no longer follows its target.*bit 12 is 0", str(error))


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ({"kind": "ignore_target"}, r"A1.*did not move.*bit 12 is 0"),
        ({"kind": "torque_display", "value": 7}, r"A1.*\(0x6077\) did not change.*moved.*0x6077"),
    ],
)
def test_a_target_that_is_never_followed_and_a_torque_that_never_changes_are_named_before_full_amplitude(
    fault: dict[str, Any], said: str, tmp_path: Path
) -> None:
    phases, error = run(cell({"axis": "A1", "at_s": 0.0, **fault}), tmp_path / "run.h5")
    assert isinstance(error, SafetyStop)
    assert re.search(said, str(error))
    assert not any("experiment" in p for p in phases)


@pytest.mark.parametrize(
    ("device", "word"),
    [(0x00040192, "a stepper drive"), (0x00010192, "a frequency converter"), (0x00000191, "profile 401")],
)
def test_a_device_that_is_no_servo_drive_is_named_and_moves_nothing(device: int, word: str) -> None:
    config = cell()
    master = connect(config)
    bus: Any = master.link.bus
    bus.cell.drives[0].node.od.put(0x1000, 0, device)
    with pytest.raises(DriveError, match=rf"A1.*0x1000.*{word}"):
        master.check()
    master.close()


def test_a_drive_of_another_kind_is_used_where_the_config_says_why() -> None:
    config = cell(overrides={"0x1000": "its firmware is a servo's"})
    master = connect(config)
    bus: Any = master.link.bus
    for drive in bus.cell.drives:
        drive.node.od.put(0x1000, 0, 0x00040192)
    assert any("a stepper drive" in w for w in master.check()[0].warnings)
    master.close()
