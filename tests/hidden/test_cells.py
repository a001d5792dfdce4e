"""Whole cells: what is sure is named beside what is not."""

from __future__ import annotations

import pytest

from hidden.cell_plants import Law
from hidden.cells import draw, scored
from invid.diagnosis.diagnose import diagnose
from invid.model.diagnosis_document import Verdict


@pytest.mark.panel
def test_free_play_beside_friction_and_a_motors_ripple_is_found() -> None:
    """With a cap on the causes and friction that turns at once, friction alone was named of it."""
    recording, truth = draw(4)
    diagnosis = diagnose(recording)
    result = scored(truth, diagnosis)
    assert result["faults"][0][0] == "backlash"
    assert result["faults"][0][-1], result["named"]
    assert result["friction"] == [1, 1]
    assert not result["wrong"]
    gap = next(f for f in diagnosis.findings if f.effect.cause == "backlash").effect.parameters["gap"]
    assert abs(gap.value - truth.faults[0].p[0]) < 0.2 * truth.faults[0].p[0]
    assert diagnosis.verdict is not Verdict.UNEXPLAINED


def test_friction_is_named_beside_what_no_catalogue_has_and_the_rest_is_a_law_of_two_quantities() -> None:
    """A damping that changes with position, at 42 dB."""
    recording, truth = draw(2, motors=1, masses=(2,), faults=(Law.SWAY,), db=42.0, gravity=False)
    diagnosis = diagnose(recording)
    result = scored(truth, diagnosis)
    assert diagnosis.verdict is Verdict.PARTLY_EXPLAINED
    assert result["friction"] == [1, 1]
    assert [f[-1] for f in result["faults"]] == [True], result["named"]
    assert not result["wrong"]
    assert diagnosis.unexplained is not None
    assert diagnosis.unexplained.axis == truth.axes[0]
    assert "even" in diagnosis.unexplained.character
    assert all(f.confidence < 0.9 for f in diagnosis.findings)


def test_periods_that_differ_are_taken_whole_and_a_motor_ripples_twice() -> None:
    """A stiffening spring with free play beside friction: the mean of three unlike periods hid the first, and
    one ripple a motor left the other."""
    recording, truth = draw(20001)
    diagnosis = diagnose(recording)
    result = scored(truth, diagnosis)
    assert [f[0] for f in result["faults"]] == ["backlash", "cubic_stiffness"]
    assert all(f[-1] for f in result["faults"]), result["named"]
    assert not result["wrong"]
    gap = next(f for f in diagnosis.findings if f.effect.cause == "backlash").effect.parameters["gap"]
    assert abs(gap.value - truth.faults[0].p[0]) < 0.02 * truth.faults[0].p[0]
    cycles = sorted(
        f.effect.parameters["cycles_per_rev"].value for f in diagnosis.findings if f.effect.cause == "cogging"
    )
    assert len(cycles) == 2
    assert abs(cycles[0] - 6.0) < 0.1
    assert abs(cycles[1] - 24.0) < 0.2


def test_a_stiffening_spring_is_found_where_no_period_is_like_the_next() -> None:
    """The mean of unlike periods hid the spring and the load's bearing behind their scatter."""
    recording, truth = draw(702)
    diagnosis = diagnose(recording)
    result = scored(truth, diagnosis)
    named = {f[0]: f[-1] for f in result["faults"]}
    assert named["cubic_stiffness"], result["named"]
    assert named["viscous_friction"], result["named"]
    assert result["gravity"] == [1, 1]
    assert not result["wrong"]
    assert max(result["floors"]) <= 1.2


def test_a_weight_that_turns_through_radians_does_not_choose_the_chain() -> None:
    """Three masses; to a linear chain the weight is a spring, and a mass of a hundredth is the nearest."""
    recording, truth = draw(410566)
    diagnosis = diagnose(recording)
    result = scored(truth, diagnosis)
    assert [f[-1] for f in result["faults"]] == [True], result["named"]
    assert not result["wrong"]
    assert result["gravity"] == [1, 1]
    assert max(result["floors"]) <= 1.2


def test_a_ripple_that_only_slow_parts_of_the_motion_show_is_found() -> None:
    """The motor turns by radians a second: 24 cycles a turn pass in the band near its reversals alone."""
    recording, truth = draw(410563)
    diagnosis = diagnose(recording)
    result = scored(truth, diagnosis)
    assert [f[-1] for f in result["faults"]] == [True], result["named"]
    assert not result["wrong"]
    cycles = [
        f.effect.parameters["cycles_per_rev"].value for f in diagnosis.findings if f.effect.cause == "cogging"
    ]
    assert any(abs(n - 24.0) < 0.2 for n in cycles), cycles
    assert max(result["floors"]) <= 1.2
