"""A mode much lighter and narrower than the chain's own: found where it is, and simulated."""

import sys
from pathlib import Path

import numpy as np
import pytest

from invid.diagnosis.diagnose import diagnose
from invid.recording import read_recording

sys.path.insert(0, str(Path(__file__).parents[2] / "system"))
import foreign_cell

MASS = 0.006
HZ = 7.3


def test_a_light_narrow_mode_is_named_at_its_frequency(tmp_path: Path) -> None:
    stiffness = MASS * (2 * np.pi * HZ) ** 2
    plant = foreign_cell.plant([[2.5, 1.8, MASS]], [[1500.0, stiffness]], {}, damping_ratio=0.012)
    experiments = foreign_cell.measure(
        plant,
        np.random.default_rng(11),
        peak=[12.0],
        period=8192,
        periods=2,
        band=(0.5, 12.0),
        hold_gain=30.0,
        torque_noise=5e-3,
    )
    path = tmp_path / "rec.h5"
    foreign_cell.write_recording(path, experiments, ["A1"])
    found = diagnose(read_recording(path), masses=[2])
    (finding,) = found.findings
    assert finding.effect.cause == "extra_mode"
    # Seen from one motor a side branch at either mass makes the same poles and zeros, and so does a base.
    assert {a.cause for a in finding.alternatives} <= {"extra_mode", "base_compliance"}
    assert "base_compliance" in {a.cause for a in finding.alternatives}
    assert "bolts" in finding.sentence or "base" in finding.sentence
    values = {name: p.value for name, p in finding.effect.parameters.items()}
    assert np.sqrt(values["stiffness"] / values["mass"]) / 2 / np.pi == pytest.approx(HZ, rel=0.01)
    (residual,) = found.residual
    assert residual.after < 1.5 * residual.noise_floor
