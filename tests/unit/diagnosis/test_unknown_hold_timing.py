"""A hold inside the drive beside the excitation, and nothing that says when it acts: looks like friction."""

import sys
from pathlib import Path

import numpy as np
import pytest

from invid.diagnosis.diagnose import diagnose
from invid.recording import read_recording

sys.path.insert(0, str(Path(__file__).parents[2] / "system"))
import foreign_cell


def _recorded(path: Path, hold_gain: float, declared: float) -> Path:
    """An axis without friction and a hold inside its drive, which looks like viscous friction of P·h/2."""
    plant = foreign_cell.plant([[2.5, 0.8]], [[1500.0]], {})
    experiments = foreign_cell.measure(
        plant,
        np.random.default_rng(7),
        peak=[12.0],
        period=4096,
        periods=2,
        band=(0.5, 12.0),
        hold_gain=hold_gain,
        torque_noise=1e-4,
        bits=21,  # rounding repeats with a motion that does: a matter of its own
    )
    for e in experiments:
        e["attributes"]["hold_gain"] = np.array([declared])
    foreign_cell.write_recording(path, experiments, ["A1"])
    return path


def test_a_stiff_hold_inside_the_drive_is_read_off_its_smooth_command_and_is_no_friction(
    tmp_path: Path,
) -> None:
    found = diagnose(read_recording(_recorded(tmp_path / "rec.h5", 800.0, np.nan)), masses=[2])
    assert found.findings == ()
    assert found.verdict == "consistent"
    assert any("A1" in w and "before the command" in w for w in found.warnings)


@pytest.mark.campaign
@pytest.mark.parametrize("told", [False, True])
def test_viscous_friction_is_doubted_where_it_may_be_a_holds_timing(tmp_path: Path, told: bool) -> None:
    # told: the axis is said to be free, so that all of its torque was held over the sample
    path = _recorded(tmp_path / "rec.h5", 800.0, 0.0 if told else 60.0)
    found = diagnose(read_recording(path), masses=[2])
    (finding,) = (f for f in found.findings if f.effect.cause == "viscous_friction")
    doubted = [w for w in found.warnings if "a hold works while the axis is driven" in w]
    assert bool(doubted) is not told
    assert (finding.confidence < 0.9) is not told
