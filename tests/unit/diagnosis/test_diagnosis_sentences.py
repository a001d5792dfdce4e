"""Sentences a technician can act on."""

from __future__ import annotations

import pytest

from invid.diagnosis.sentences import finding_sentence, format_estimate
from invid.model.diagnosis_document import Alternative
from invid.model.document import EffectTerm, Estimate


def test_a_delay_is_told_in_milliseconds_with_its_uncertainty() -> None:
    term = EffectTerm("torque_delay", "A2", {"delay": Estimate(5.942e-4, 3.1e-6, "s")})
    said = finding_sentence(term, 0.97, 0.99, (), (3, 3), ("A1", "A2"))
    assert "0.5942 ± 0.0031 ms" in said
    assert said.startswith("Axis A2")
    assert "97 %" in said


def test_alternatives_and_what_would_separate_them_are_in_the_sentence() -> None:
    term = EffectTerm("coulomb_friction", "A2", {"torque": Estimate(2.0, 0.1, "N·m")}, "mass 1")
    rival = Alternative("stribeck_friction", "A2", "mass 1", 0.06)
    said = finding_sentence(term, 0.97, 0.85, (rival,), (3, 3), ("A1", "A2"))
    assert "2.00 ± 0.10 N·m at the motor" in said
    assert "cannot tell" in said
    assert "constant-velocity" in said
    assert "Check brake release" not in said, "nothing is repaired for a cause that may be another"
    sure = finding_sentence(term, 0.97, 0.95, (), (3, 3), ("A1", "A2"))
    assert sure.endswith("Check brake release and lubrication.")


@pytest.mark.parametrize(
    ("value", "std", "said"),
    [
        (561084.0, 147700.0, "5.6e+05 ± 1.5e+05"),
        (561084.0, 5120.0, "5.611e+05 ± 5.1e+03"),
        (1.2345e-4, 3.1e-8, "0.00012345 ± 3.1e-08"),
        (3.1e-5, 4.4e-5, "3.1e-05 ± 4.4e-05"),
        (2.0, 0.1, "2.00 ± 0.10"),
    ],
)
def test_a_number_has_the_digits_that_its_deviation_leaves(value: float, std: float, said: str) -> None:
    assert format_estimate(Estimate(value, std, "1")) == said
