"""The same promise on the second generator: aperiodic, smoothed, a demand logged beside holds."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from invid.diagnosis import Verdict
from invid.discrepancy import diagnose
from invid.trajectory import is_trajectory

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.foreign import make_foreign
from hidden.scoring import score


def test_a_demand_logged_beside_the_hold_of_a_chirp_leaves_no_friction_that_is_not_there() -> None:
    recording, truth = make_foreign(2, cause="null", excitation="chirp")
    assert recording.experiments[0].torque_demand is not None
    diagnosis = diagnose(recording)
    assert diagnosis.findings == (), truth.settings
    assert diagnosis.verdict is Verdict.CONSISTENT


def test_friction_whose_sign_is_rounded_is_named_with_its_size() -> None:
    recording, truth = make_foreign(0, cause="coulomb_friction", excitation="full", motors=1)
    result = score(truth, diagnose(recording))
    assert result.outcome == "right", result.named
    assert result.size_error is not None
    assert abs(result.size_error) < 0.05


@pytest.mark.parametrize(("excitation", "seed"), [("noise", 540003), ("stepped", 540004), ("noise", 540005)])
def test_a_chain_shaken_without_periods_and_without_declared_masses_is_no_rigid_axis(
    excitation: str, seed: int
) -> None:
    recording, _ = make_foreign(seed, cause="null", excitation=excitation)
    assert not is_trajectory(replace(recording, masses_per_axis=None))
