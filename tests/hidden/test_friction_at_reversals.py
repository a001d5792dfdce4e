"""Dry friction turns round while the motor does, and bends its velocity there."""

from __future__ import annotations

import pytest

from hidden.generator import make, make_case
from hidden.scoring import score
from invid.diagnosis.diagnose import diagnose
from invid.model.diagnosis_document import Verdict
from invid.signals.dropped_rows import find_dropped_rows


@pytest.mark.parametrize("seed", [2, 3])
def test_strong_dry_friction_of_a_motor_leaves_nothing_but_noise(seed: int) -> None:
    """With straight velocities, cut at the noise, these left 1.14 and 1.16 times the floor on other data."""
    recording, truth = make("coulomb_friction", seed=seed, target_db=35, motors=1)
    result = score(truth, diagnose(recording))
    assert result.outcome == "right"
    assert result.over_floor is not None
    assert result.over_floor < 1.08


def test_what_is_explained_is_consistent_with_the_extended_model() -> None:
    """A twelfth more than the noise is left: that was explained, and unexplained with the same model."""
    recording, _ = make("coulomb_friction", seed=2, target_db=38, motors=1)
    found = diagnose(recording)
    assert found.verdict is Verdict.EXPLAINED
    again = diagnose(recording, model=found.model)
    assert again.verdict is Verdict.CONSISTENT
    assert not again.findings


def test_the_share_of_lost_rows_is_right_where_many_repeat_by_chance() -> None:
    """A rounded torque and a coarse encoder repeat together: 0.9 % were said of 1.4 %."""
    recording, truth = make_case(1010072)
    (found,) = find_dropped_rows(recording)
    true = truth.effects[0].parameters["fraction"]
    assert abs(found.fraction - true) < 3.0 * found.std
    assert found.fraction == pytest.approx(true, rel=0.1)


def test_friction_that_differs_between_the_directions_is_one_cause_and_not_two() -> None:
    """At 6 dB a constant torque and dry friction leave noise as well, with two parameters fewer."""
    recording, truth = make_case(1040127)
    diagnosis = diagnose(recording)
    assert score(truth, diagnosis).outcome == "right"
    (finding,) = diagnosis.findings
    assert "coulomb_friction" in {a.cause for a in finding.alternatives}
    assert finding.confidence < 0.9


def test_a_constant_torque_and_dry_friction_are_named_and_may_be_one_cause() -> None:
    recording, truth = make("coulomb_friction", second="torque_offset", seed=1, target_db=22, motors=1)
    diagnosis = diagnose(recording)
    assert score(truth, diagnosis).outcome == "right"
    for finding in diagnosis.findings:
        assert "asymmetric_friction" in {a.cause for a in finding.alternatives}
        assert finding.confidence < 0.9


def test_viscous_friction_whose_size_a_hold_hides_is_named_without_certainty() -> None:
    """It takes nine tenths of what an eccentric encoder leaves, down to the noise."""
    recording, truth = make_case(1040062)
    diagnosis = diagnose(recording)
    assert score(truth, diagnosis).outcome == "right"
    (viscous,) = (f for f in diagnosis.findings if f.effect.cause == "viscous_friction")
    assert viscous.confidence <= 0.5
