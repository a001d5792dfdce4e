"""A hold inside the drive beside the excitation, and nothing that says when it acts: looks like friction."""

import sys
from pathlib import Path

import numpy as np

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


def test_viscous_friction_that_an_unknown_hold_may_make_is_in_doubt(tmp_path: Path) -> None:
    found = diagnose(read_recording(_recorded(tmp_path / "rec.h5", 800.0, np.nan)), masses=[2])
    assert all(f.cause == "viscous_friction" and f.confidence < 0.9 for f in found.findings)
    assert bool(found.findings) is any("a hold works while the axis is driven" in w for w in found.warnings)
