"""What the search settles at on a real arm: no wrong first choice stays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import invid
from invid.recording import Role
from invid.rigid_motion.analysis import analyse
from invid.rigid_motion.fit import axis_powers

ROOT = Path(__file__).parents[3]
PENDULUM = next(
    (p for n in (0, 1) if (p := ROOT.parents[n] / "shared/data/double_pendulum").is_dir()), ROOT / "nowhere"
)


@pytest.mark.skipif(not PENDULUM.is_dir(), reason="the measured double pendulum (../shared/data) is not here")
@pytest.mark.parametrize(("fitted", "kept_out", "most"), [(0, 1, 0.2), (1, 0, 0.05)])
def test_the_weight_of_the_link_that_hangs_is_found_though_the_own_link_s_came_first(
    fitted: int, kept_out: int, most: float, tmp_path: Path
) -> None:
    """Two links in a plane: the outer falls by the sum of both angles. Missed were 240 and 37 % there."""
    measured = invid.import_recording(PENDULUM, ROOT / "configs/import/double_pendulum.yaml")
    kept = measured.experiments[fitted], replace(measured.experiments[kept_out], role=Role.VALIDATE)
    a = analyse(replace(measured, experiments=kept))
    assert [t.other for t in a.final.terms if t.cause == "gravity" and t.axis == 1] == [0]
    left, torque = (
        np.sqrt(axis_powers(a.rows, a.rows.judged, x)[1]) for x in (a.final.held_out, a.rows.torque)
    )
    assert left < most * torque
