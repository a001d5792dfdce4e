"""Sentences a technician can act on."""

from __future__ import annotations

from invid.diagnosis import Alternative
from invid.discrepancy.words import finding_sentence
from invid.model import EffectTerm, Estimate


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
    assert said.endswith("Check brake release and lubrication.")
