"""The same promise on the second generator: aperiodic, smoothed, a demand logged beside holds."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from invid.diagnosis.diagnose import diagnose
from invid.model.diagnosis_document import Verdict
from invid.rigid_motion.record_kind import is_trajectory

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


@pytest.mark.panel
@pytest.mark.parametrize(("excitation", "seed"), [("noise", 540003), ("stepped", 540004), ("noise", 540005)])
def test_a_chain_shaken_without_periods_and_without_declared_masses_is_no_rigid_axis(
    excitation: str, seed: int
) -> None:
    recording, _ = make_foreign(seed, cause="null", excitation=excitation)
    assert not is_trajectory(replace(recording, masses_per_axis=None))


def test_a_wrong_torque_scale_beside_holds_whose_timing_nobody_logged_is_named_with_its_equals() -> None:
    recording, truth = make_foreign(540015, cause="torque_gain", excitation="full")
    diagnosis = diagnose(recording)
    assert score(truth, diagnosis).outcome == "right", diagnosis.sentences
    # An encoder of the wrong scale is the same data on so small a motion: neither fits better.
    others = {(a.cause, a.axis) for a in diagnosis.findings[0].alternatives}
    assert ("encoder_eccentricity", "A1") in others
    assert ("encoder_eccentricity", "A2") in others
    assert "torque_gain" in {cause for cause, _ in others}
    assert diagnosis.findings[0].confidence < 0.9


def test_a_hold_that_acts_at_no_time_of_its_own_hides_no_torque_scale() -> None:
    recording, truth = make_foreign(
        440024
    )  # no demand logged, no torque noise: half a sample is all there is
    result = score(truth, diagnose(recording, masses=[2, 2]))
    assert result.outcome == "right", result.named
    assert result.size_error is not None
    assert abs(result.size_error) < 0.03


@pytest.mark.parametrize("excitation", ["chirp", "odd", "stepped"])
def test_a_hold_inside_the_drive_of_a_lone_axis_is_no_friction(excitation: str) -> None:
    recording, truth = make_foreign(540100, cause="null", excitation=excitation)
    assert recording.experiments[0].torque_demand is None
    diagnosis = diagnose(recording, masses=truth.settings["masses"])
    assert diagnosis.findings == (), diagnosis.sentences
    assert diagnosis.verdict is Verdict.CONSISTENT


def test_cogging_in_a_chirp_stands_alone_and_has_its_size() -> None:
    recording, truth = make_foreign(440013)
    result = score(truth, diagnose(recording))
    assert result.outcome == "right", result.named  # viscous friction stood beside it
    assert result.size_error is not None
    assert abs(result.size_error) < 0.01


def test_beside_a_hold_whose_gains_nobody_knows_nothing_is_named_for_sure() -> None:
    recording, truth = make_foreign(540340, cause="null", excitation="odd")
    diagnosis = diagnose(recording, masses=truth.settings["masses"])
    # Not consistent, as it should be; but a mode was named at 0.999.
    assert all(f.confidence < 0.9 for f in diagnosis.findings), diagnosis.sentences
