"""What the torque at rest says of loads."""

from typing import Any

import numpy as np
import pytest

from invid.config import CellConfig
from invid.sweep.loads import CONFIRM_S, judge_loads

CYCLE, RATED = 0.004, 10.0


def config(stated: Any) -> CellConfig:
    axis: dict[str, Any] = {
        "name": "A1",
        "node_id": 1,
        "limits": {"torque_Nm": 5, "position_window_rad": 1, "velocity_rad_per_s": 1},
    }
    if stated != "unstated":
        axis["gravity_loaded"] = stated
    return CellConfig.model_validate(
        {
            "format": "invid-config",
            "robot": "r",
            "bus": {"interface": "invid-virtual", "channel": "c"},
            "axes": [axis],
        }
    )


def judged(stated: Any, torque: Any, *, held: bool = True) -> Any:
    n = round(CONFIRM_S / CYCLE)
    noise = np.random.default_rng(1).normal(0.0, 0.02, n)
    rows = np.round((np.broadcast_to(torque, n) + noise) * 100) / 100
    return judge_loads(config(stated), rows[:, None], np.ones((n, 1), bool), [held], [RATED])[0]


@pytest.mark.parametrize("stated", ["unstated", "unknown", False])
def test_torque_at_rest_contradicts_a_load_that_is_not_stated(stated: Any) -> None:
    found = judged(stated, -0.8)
    assert found.loaded
    assert found.torque == pytest.approx(-0.8, abs=0.01)
    assert "gravity_loaded: true" in found.said


@pytest.mark.parametrize("stated", ["unstated", False])
def test_what_swings_behind_a_held_motor_is_no_load(stated: Any) -> None:
    t = CYCLE * np.arange(round(CONFIRM_S / CYCLE))
    for hz in (1.5, 2.2, 3.1, 7.0):
        found = judged(stated, 2.0 * np.sin(2 * np.pi * hz * t + 1.0))
        assert not found.loaded, hz
        assert found.said == ""


def test_an_axis_that_its_drive_does_not_hold_counts_as_loaded_unless_stated() -> None:
    assert judged("unstated", 0.0, held=False).loaded
    assert not judged(False, 0.0, held=False).loaded
