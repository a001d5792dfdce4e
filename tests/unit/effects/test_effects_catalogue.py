"""Every cause of the contract is there, with its parameters; laws against values worked out by hand."""

import re
from pathlib import Path

import numpy as np
import pytest

from invid.effects.laws.slider import slide
from invid.effects.registry import CATALOGUE
from invid.model.plant import Structure

CONTRACT = {
    "coulomb_friction": {"torque"},
    "viscous_friction": {"coefficient"},
    "stribeck_friction": {"static", "coulomb", "velocity"},
    "presliding_friction": {"stiffness", "torque"},
    "asymmetric_friction": {"coulomb_positive", "coulomb_negative", "viscous_positive", "viscous_negative"},
    "torque_offset": {"torque"},
    "cogging": {"torque", "cycles_per_rev", "phase"},
    "torque_delay": {"delay"},
    "torque_lag": {"time_constant"},
    "torque_gain": {"gain"},
    "torque_saturation": {"limit"},
    "encoder_eccentricity": {"amplitude", "phase"},
    "dropped_samples": {"fraction"},
    "spring_damping": {"coefficient"},
    "cubic_stiffness": {"coefficient"},
    "backlash": {"gap"},
    "spring_hysteresis": {"stiffness", "torque"},
    "transmission_error": {"amplitude", "cycles_per_rev", "phase"},
    "gravity": {"torque", "angle"},
    "extra_mode": {"mass", "stiffness", "damping_ratio"},  # the last is ours: it is fitted, so it is said
    "coupling_stiffness": {"stiffness"},
    "base_compliance": {"mass", "stiffness", "damping_ratio"},  # and shares, where there are more axes
    "payload_change": {"mass", "time"},
    "parameter_drift": {"parameter", "rate"},
}


def test_the_catalogue_holds_every_cause_of_the_contract_with_its_parameters() -> None:
    assert {e.cause: set(e.parameters) for e in CATALOGUE} == CONTRACT


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda e: e.cause)
def test_every_cause_is_explained_in_the_reference(effect) -> None:
    text = (Path(__file__).parents[3] / "docs" / "reference" / "causes.md").read_text(encoding="utf-8")
    assert re.search(rf"^### `{effect.cause}`", text, re.MULTILINE)


def test_places_of_springs_and_masses_count_from_the_motor() -> None:
    structure = Structure((2, 3))
    by_cause = {e.cause: e for e in CATALOGUE}
    springs = [(p.axis, p.element) for p in by_cause["backlash"].places(structure)]
    assert springs == [(0, "spring 1"), (1, "spring 1"), (1, "spring 2")]
    assert [p.pattern(structure) for p in by_cause["coupling_stiffness"].places(structure)] == [
        ((1, 1.0), (4, -1.0))
    ]
    assert [p.element for p in by_cause["payload_change"].places(structure)] == ["mass 2", "mass 3"]
    # Weight hangs on the load; the motor may carry some.
    assert [p.element for p in by_cause["gravity"].places(structure)] == [
        "mass 2",
        "mass 3",
        "mass 1",
        "mass 1",
    ]


def test_a_slider_walks_the_loop_worked_out_by_hand() -> None:
    x = np.array([0.0, 1.0, 2.0, 1.5, 0.5, -1.0])
    np.testing.assert_allclose(slide(x, 1.0, periodic=False), [0.0, 1.0, 1.0, 0.5, -0.5, -1.0])
    # A record that still settles comes from motion like its own, and so does the slider.
    swing = 2.0 * np.sin(np.linspace(0.3, 0.3 + 6 * np.pi, 601))
    settled = slide(swing, 1.0, periodic=True)
    assert settled[0] > 0.5
    for drift, begun in ((1e-3, settled[0]), (0.5, 0.0)):
        moved = slide(swing + np.linspace(0, drift, 601), 1.0, periodic=False)
        assert moved[0] == pytest.approx(begun, abs=1e-2)
