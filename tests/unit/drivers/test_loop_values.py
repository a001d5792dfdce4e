"""Values of loops read from drives, written by a person's act, measured in closed loop, undone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from invid.config import CellConfig
from invid.errors import DriveError, InputError
from invid.model.chains import CoupledChains
from invid.model.document import Model, parameter_vector, std_by_name
from invid.recording import read_recording
from invid.tuning.axis_loop import AxisLoop
from invid.tuning.feedforward import NONE
from invid.tuning.motor_scale import MotorScale
from invid.tuning.page import axis_sentence
from invid.tuning.servo_loop import DriveTiming, Gains, Notch
from invid.tuning.verification import Verdict, Verification, verify
from invid_drivers.connect import connect
from invid_drivers.measurement import measure_to_file
from invid_drivers.values.applying import Proposal, apply, propose, undo, written_entries
from invid_drivers.values.closed_loop import closed_loop_config
from invid_drivers.values.present import present_values

MOTOR, LOAD, SPRING = 1.0, 2.0, 1500.0
TUNED = AxisLoop(Gains(90.0, 0.13, 7.7, (Notch(40.0, 0.1, 0.8),)), replace(NONE, inertia=3.0))


def cell(folder: Path, *axes: dict, **more) -> CellConfig:
    """Two masses on a spring behind a drive whose loops run once in a millisecond."""
    return CellConfig.model_validate(
        {
            "format": "invid-config",
            "format_version": 1,
            "robot": "bench",
            "bus": {"interface": "invid-virtual", "channel": "values", "cycle_s": 0.001},
            "axes": [
                {
                    "name": "A1",
                    "node_id": 1,
                    "rated_torque_Nm": 50,
                    "inertia_kgm2": 3.0,
                    "gravity_loaded": False,
                    "limits": {"torque_Nm": 25, "position_window_rad": 1.0, "velocity_rad_per_s": 4,
                               "stopping_room_rad": 3},
                    **more,
                }
            ],
            "simulation": {
                "memory": str(folder / "drives.json"),
                "plant": {
                    "branches": [
                        {"axis": "A1", "masses": [MOTOR, LOAD], "springs": [SPRING], "dampers": [1.0]}
                    ]
                },
                "defaults": {"loop_cycle_s": 0.001, "torque_noise": 0.001, **(axes[0] if axes else {})},
            },
        }
    )  # fmt: skip


def yes(proposal: object) -> None:
    """A person who agrees."""


def no(proposal: object) -> None:
    raise InputError("not confirmed")


def held(config: CellConfig) -> dict[str, float]:
    (found,) = present_values(config, {})
    return {row.at.name: value for row, value in found.values.items()}


def test_what_a_drive_holds_is_read_and_is_the_loop_that_it_runs(tmp_path: Path) -> None:
    (found,) = present_values(cell(tmp_path), {})
    assert found.loop is not None
    bandwidth = 2 * np.pi * 25.0  # as simulated drives come
    assert found.loop.gains.velocity_gain == pytest.approx(1.4 * MOTOR * bandwidth, rel=1e-6)
    assert found.loop.gains.position_gain == pytest.approx(bandwidth / 1.4, rel=1e-6)
    assert np.isinf(found.loop.gains.integral_time)
    assert any(text.startswith("0x6072") for text in found.others)


def test_a_drive_without_rows_shows_its_standard_sets_as_they_are(tmp_path: Path) -> None:
    lacks = ["0x2500", "0x2501", "0x2502"]
    (found,) = present_values(cell(tmp_path, {"objects": {"lacks": lacks}}), {})
    assert found.loop is None


def test_values_are_written_read_back_outlive_a_check_and_come_back(tmp_path: Path) -> None:
    config = cell(tmp_path)
    before = held(config)
    seen: list[Proposal] = []
    apply(config, {"A1": TUNED}, {}, seen.append)
    after = held(config)
    assert after["velocity gain"] == pytest.approx(90.0, rel=1e-6)
    assert after["notch 1 frequency"] == pytest.approx(40.0, rel=1e-6)
    assert {c.row.at.name: (c.old, c.new) for c in seen[0].changes}["integral time"] == (
        0.0,
        pytest.approx(0.13),
    )
    # a check restores what a run left: not what a person wrote
    checked = connect(config)
    checked.check()
    checked.close()
    assert held(config) == after
    count, said = undo(config, yes)
    assert (count, said) == (len(seen[0].changes), ())
    assert held(config) == before
    assert written_entries(config) == ()
    with pytest.raises(InputError, match="nothing that was written"):
        undo(config, yes)


def test_nothing_is_written_where_nobody_agrees(tmp_path: Path) -> None:
    config = cell(tmp_path)
    before = held(config)
    with pytest.raises(InputError, match="not confirmed"):
        apply(config, {"A1": TUNED}, {}, no)
    assert held(config) == before
    assert written_entries(config) == ()
    assert len(propose(config, {"A1": TUNED}, {}).changes) == 7
    assert held(config) == before


def test_a_value_that_somebody_set_since_is_left_and_said(tmp_path: Path) -> None:
    config = cell(tmp_path)
    apply(config, {"A1": TUNED}, {}, yes)
    kept = json.loads((tmp_path / "drives.json").read_text(encoding="utf-8"))
    kept["A1"]["0x2500:1"] += 1000
    (tmp_path / "drives.json").write_text(json.dumps(kept), encoding="utf-8")
    _, said = undo(config, yes)
    assert len(said) == 1
    assert "set since, left as it is" in said[0]
    assert "velocity gain" in said[0]
    assert held(config)["velocity gain"] > 90.0
    assert held(config)["integral time"] == 0.0


def test_a_drive_that_refuses_one_value_is_left_as_it_was(tmp_path: Path) -> None:
    config = cell(tmp_path, {"objects": {"read_only": ["0x2501:1"]}})
    before = held(config)
    with pytest.raises(DriveError, match="0x2501:1"):
        apply(config, {"A1": TUNED}, {}, yes)
    assert held(config) == before
    assert written_entries(config) == ()


def test_an_object_whose_range_is_not_known_is_not_written(tmp_path: Path) -> None:
    config = cell(tmp_path, {"objects": {"profile": "epos4"}}, vendor="epos4", position_rad_per_count=1.2e-5)
    motors = {"A1": MotorScale(gear=1.0, torque_constant_Nm_per_A=50.0 / 3.0)}
    (found,) = present_values(config, motors)
    gain = next(v for row, v in found.values.items() if row.at.address == "0x30A2:1")
    assert gain * 1e-6 * 50.0 / 3.0 == pytest.approx(1.4 * MOTOR * 2 * np.pi * 25.0, rel=1e-3)
    assert found.loop is None, "its position loop is not read"
    with pytest.raises(DriveError, match="range of 0x30A2:1"):
        apply(config, {"A1": replace(TUNED, gains=replace(TUNED.gains, notches=()))}, motors, yes)


def model(spring: float = SPRING, load: float = LOAD) -> Model:
    chains = CoupledChains.build([[MOTOR, load]], [[spring]], [[1.0]], [[0.0]], axes=["A1"])
    names, values = parameter_vector(chains)
    std = std_by_name(chains, {n: 0.003 * abs(v) for n, v in zip(names, values, strict=True)})
    return Model("bench", "refined", chains, std)


def verified(config: CellConfig, folder: Path, believed: Model, loop: AxisLoop) -> Verification:
    """``loop`` written into the drive and measured, beside what ``believed`` says of it."""
    apply(config, {"A1": loop}, {}, yes)
    path = folder / "closed.h5"
    measure_to_file(closed_loop_config(config), path)
    return verify(believed, {"A1": loop}, DriveTiming(0.001), read_recording(path))


@pytest.mark.parametrize(
    ("believed", "verdicts"),
    [
        (model(), {Verdict.AS_PREDICTED}),
        (model(load=6.0 * LOAD, spring=3.0 * SPRING), {Verdict.WORSE, Verdict.OTHER}),
    ],
)
def test_the_loops_measured_while_closed_are_those_predicted_unless_the_model_is_wrong(
    tmp_path: Path, believed: Model, verdicts: set[Verdict]
) -> None:
    found = verified(cell(tmp_path), tmp_path, believed, TUNED)
    assert found.verdict in verdicts, found.axes[0]


def test_values_that_are_written_into_a_drive_as_it_comes_are_verified_as_predicted(tmp_path: Path) -> None:
    config = cell(tmp_path, {"loop_cycle_s": 0.0})
    assert verified(config, tmp_path, model(), TUNED).verdict is Verdict.AS_PREDICTED


def test_a_model_that_is_wrong_asks_for_the_undo_and_says_what_the_move_would_miss(tmp_path: Path) -> None:
    found = verified(
        cell(tmp_path),
        tmp_path,
        model(load=0.2 * LOAD),
        replace(TUNED, feedforward=replace(NONE, inertia=1.4)),
    )
    (axis,) = found.axes
    assert found.verdict.asks_for_undo
    assert axis.following.measured > 2.0 * axis.following.high
    assert "write the old values back" in axis_sentence(axis)


def test_an_axis_that_its_loop_does_not_hold_is_worse_whatever_its_margins_are(tmp_path: Path) -> None:
    """Seen of a coarse encoder: gains so small that the sensitivity is one, as predicted."""
    weak = AxisLoop(Gains(0.2, 30.0, 0.03), replace(NONE, inertia=3.0))
    config = cell(tmp_path, {"encoder_counts": 8192, "friction": {"coulomb_Nm": 0.1}})
    (axis,) = verified(config, tmp_path, model(), weak).axes
    assert axis.sensitivity.measured == pytest.approx(axis.sensitivity.predicted, rel=0.05)
    assert axis.verdict is Verdict.WORSE
    assert "it is not held" in axis_sentence(axis)
