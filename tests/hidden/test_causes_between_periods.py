"""Causes that the usual records of a fit do not show: between periods, and above a validation's amplitude."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from invid.diagnosis.diagnose import diagnose

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.generator import make, make_case
from hidden.scoring import score


def test_a_drift_of_two_periods_is_no_tone_between_two_lines() -> None:
    recording, truth = make(
        "parameter_drift", (0, 1), {"rate": -0.3}, seed=11, masses=(2,), noise=0.003, drive="smooth",
        periods=2, moves=False, from_rest=False, torque_quantised=False,
    )  # fmt: skip
    found = diagnose(recording)
    (drift,) = found.findings
    assert drift.cause == "parameter_drift"
    rate = drift.parameters["rate"]
    assert rate.value == pytest.approx(truth.effects[0].parameters["rate"], rel=0.01)
    assert rate.std
    assert found.residual[0].after < 1.2 * found.residual[0].floor


def test_a_limit_that_the_validation_stays_below_is_named() -> None:
    recording, truth = make_case(930040)
    found = diagnose(recording)
    result = score(truth, found)
    assert result.outcome == "right", result.named
    assert result.size_error is not None
    assert abs(result.size_error) < 0.01
    assert any("validation does not show" in w for w in found.warnings)


def test_a_mode_narrower_than_the_lines_are_apart_is_looked_for_between_them() -> None:
    """0.7 g·m² at 6.95 Hz among lines at 6.9 and 7.1 Hz: neither is near enough for a step to lead there."""
    recording, truth = make_case(1007045)
    d = diagnose(recording)
    assert score(truth, d).outcome == "right"
    mass = d.findings[0].effect.parameters["mass"].value
    stiffness = d.findings[0].effect.parameters["stiffness"].value
    true = truth.effects[0].parameters
    assert stiffness / mass == pytest.approx(true["stiffness"] / true["mass"], rel=0.01)
