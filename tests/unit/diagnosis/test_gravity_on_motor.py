"""Weight that a motor carries itself is gravity, not cogging of a cycle and a half."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from invid.diagnosis.diagnose import diagnose
from invid.identification.identify import identify

sys.path.insert(0, str(Path(__file__).parents[2]))
from hidden.foreign import make_foreign
from hidden.generator import make


@pytest.mark.campaign
def test_weight_at_the_motor_is_gravity_with_its_place_open() -> None:
    recording, truth = make_foreign(640013)  # two axes, gravity before the springs of A2
    (finding,) = diagnose(recording).findings
    assert (finding.effect.cause, finding.effect.axis) == ("gravity", "A2")
    named = {finding.effect.element, *(a.element for a in finding.alternatives)}
    assert truth.effects[0].element in named
    size = finding.effect.parameters["torque"]
    assert size.value == pytest.approx(truth.effects[0].parameters["torque"], rel=0.02)
    assert finding.confidence < 0.9


@pytest.mark.campaign
def test_a_cause_whose_size_is_not_told_from_none_is_not_sure() -> None:
    """Seed 640010: cogging of 0.2 ± 0.3 N·m was named at 1.00 beside the strong cause."""
    recording, _ = make_foreign(640010)
    for finding in diagnose(recording).findings:
        if finding.effect.cause == "cogging":
            size = finding.effect.parameters["torque"]
            assert size.std is not None
            assert size.value > 2.0 * size.std or finding.confidence <= 0.5


@pytest.mark.campaign
def test_a_weight_that_a_model_without_weights_does_not_know_leaves_no_spring_to_ground() -> None:
    """Around its place of rest a weight is a spring; the identification knows no weights."""
    size = {"torque": 300.0, "angle": 0.4}
    recording, _ = make("gravity", (0, 1), size, seed=1, masses=(2,), noise=0.003, moves=False)
    model = identify(recording)
    found = diagnose(recording, model=model)
    (finding,) = found.findings
    assert finding.cause == "gravity"
    assert found.model.chains.ground_springs[0] == 0.0
    assert found.model.fit["trustworthy"]
    for name, true in size.items():
        estimate = finding.parameters[name]
        assert estimate.std is not None
        assert abs(estimate.value - true) < 4.0 * estimate.std
        assert estimate.std < 0.01 * true
