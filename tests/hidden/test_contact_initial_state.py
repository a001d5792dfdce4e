"""What a contact remembers from before a record."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

from hidden.generator import make_case
from invid.diagnosis.diagnose import diagnose


def test_presliding_friction_is_found_where_a_weak_record_begins_with_the_contact_under_tension() -> None:
    """The second level moves the far mass too little to slide in both directions: from rest the law leaves
    480 times the noise there, and the fit of both records stood far from either."""
    recording, truth = make_case(1007016)
    (true,) = truth.effects
    d = diagnose(recording)
    (finding,) = d.findings
    assert (finding.effect.cause, finding.effect.element) == ("presliding_friction", true.element)
    assert finding.confidence > 0.9
    for name in ("torque", "stiffness"):
        found = finding.effect.parameters[name]
        assert found.value == pytest.approx(true.parameters[name], rel=0.02)
        assert found.std is not None
        assert abs(found.value - true.parameters[name]) < 3 * found.std
    assert d.residual[0].after < 1.2 * d.residual[0].noise_floor


def test_a_contact_that_never_slides_both_ways_in_a_period_may_hold_any_constant_torque() -> None:
    recording, truth = make_case(1010010)
    (true,) = truth.effects
    (finding,) = diagnose(recording).findings
    assert (finding.effect.cause, finding.effect.axis) == ("presliding_friction", true.axis)
    assert finding.effect.element == true.element
    assert finding.effect.parameters["torque"].value == pytest.approx(true.parameters["torque"], rel=0.02)
