"""The loops of drives measured while they are closed, beside what a tuning predicts."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from invid.config import CellConfig
from invid.model.chains import CoupledChains
from invid.model.document import Model, parameter_vector, std_by_name
from invid.recording import Recording, read_recording
from invid.tuning.axis_loop import AxisLoop
from invid.tuning.feedforward import NONE
from invid.tuning.page import axis_sentence
from invid.tuning.servo_loop import DriveTiming, Gains, Notch
from invid.tuning.verification import Verdict, Verification, verify
from invid_drivers.measurement import measure_to_file
from invid_drivers.simulated import kernel
from invid_drivers.simulated.cell import SimulatedCell
from invid_drivers.values.closed_loop import closed_loop_config

MOTOR, LOAD, SPRING = 1.0, 2.0, 1500.0
TUNED = AxisLoop(Gains(90.0, 0.13, 7.7, (Notch(40.0, 0.1, 0.8),)), replace(NONE, inertia=3.0))


def cell(*axes: dict[str, Any]) -> CellConfig:
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
                }
            ],
            "simulation": {
                "plant": {
                    "branches": [
                        {"axis": "A1", "masses": [MOTOR, LOAD], "springs": [SPRING], "dampers": [1.0]}
                    ]
                },
                "defaults": {"loop_cycle_s": 0.001, "torque_noise": 0.001, **(axes[0] if axes else {})},
            },
        }
    )  # fmt: skip


def stated(loop: AxisLoop) -> dict[str, Any]:
    """``loop`` as the config of a simulated drive states it."""
    return asdict(loop.gains) | {"inertia": loop.feedforward.inertia, "viscous": loop.feedforward.viscous}


def test_a_drive_runs_the_loops_that_its_config_states() -> None:
    own, given = (SimulatedCell(cell(*axes)).plant.command[0] for axes in ((), ({"loops": stated(TUNED)},)))
    bandwidth = 2.0 * np.pi * 25.0  # as simulated drives come
    assert own[kernel.VELOCITY_GAIN] == pytest.approx(1.4 * MOTOR * bandwidth)
    assert own[kernel.POSITION_GAIN] == pytest.approx(bandwidth / 1.4)
    assert own[kernel.RESET] == 0.0
    assert given[kernel.RESET] == pytest.approx(1.0 / 0.13)
    assert (given[kernel.VELOCITY_GAIN], given[kernel.CYCLE]) == (90.0, 0.001)


def model(spring: float = SPRING, load: float = LOAD) -> Model:
    chains = CoupledChains.build([[MOTOR, load]], [[spring]], [[1.0]], [[0.0]], axes=["A1"])
    names, values = parameter_vector(chains)
    std = std_by_name(chains, {n: 0.003 * abs(v) for n, v in zip(names, values, strict=True)})
    return Model("bench", "refined", chains, std)


def measured(folder: Path, loop: AxisLoop, **drive: Any) -> Recording:
    """The loops of a drive that runs ``loop``, closed."""
    path = folder / "closed.h5"
    measure_to_file(closed_loop_config(cell({"loops": stated(loop), **drive})), path)
    return read_recording(path)


def verified(recording: Recording, believed: Model, loop: AxisLoop) -> Verification:
    """What was measured of ``loop`` beside what ``believed`` says of it."""
    return verify(believed, {"A1": loop}, DriveTiming(0.001), recording)


def test_the_loops_measured_while_closed_are_those_predicted_unless_the_model_is_wrong(
    tmp_path: Path,
) -> None:
    recording = measured(tmp_path, TUNED)
    assert verified(recording, model(), TUNED).verdict is Verdict.AS_PREDICTED
    wrong = verified(recording, model(load=6.0 * LOAD, spring=3.0 * SPRING), TUNED)
    assert wrong.verdict in {Verdict.WORSE, Verdict.OTHER}, wrong.axes[0]


@pytest.mark.campaign
def test_values_in_a_drive_that_states_no_cycle_are_verified_as_predicted(tmp_path: Path) -> None:
    recording = measured(tmp_path, TUNED, loop_cycle_s=0.0)
    assert verified(recording, model(), TUNED).verdict is Verdict.AS_PREDICTED


def test_a_model_that_is_wrong_asks_for_the_undo_and_says_what_the_move_would_miss(tmp_path: Path) -> None:
    loop = replace(TUNED, feedforward=replace(NONE, inertia=1.4))
    found = verified(measured(tmp_path, loop), model(load=0.2 * LOAD), loop)
    (axis,) = found.axes
    assert found.verdict.asks_for_undo
    assert axis.following.measured > 2.0 * axis.following.high
    assert "write the old values back" in axis_sentence(axis)


def test_an_axis_that_its_loop_does_not_hold_is_worse_whatever_its_margins_are(tmp_path: Path) -> None:
    """Seen of a coarse encoder: gains so small that the sensitivity is one, as predicted."""
    weak = AxisLoop(Gains(0.2, 30.0, 0.03), replace(NONE, inertia=3.0))
    coarse = {"encoder_counts": 8192, "friction": {"coulomb_Nm": 0.1}}
    (axis,) = verified(measured(tmp_path, weak, **coarse), model(), weak).axes
    assert axis.sensitivity.measured == pytest.approx(axis.sensitivity.predicted, rel=0.05)
    assert axis.verdict is Verdict.WORSE
    assert "it is not held" in axis_sentence(axis)
