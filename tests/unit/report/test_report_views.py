"""A cause seen over velocity, position, deflection and frequency: the shapes a person can check by eye.

Recordings come from the hidden tests' own integrator and physics, not from the product's simulator.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from hidden.generator import Truth, make

from invid.model.diagnosis_document import AxisResidual, Diagnosis, Finding, Verdict
from invid.model.document import ChainStd, EffectTerm, Estimate, Model
from invid.recording.model import Recording
from invid.report.dependence import cause_views

TORQUE = 2.0


def diagnosed(recording: Recording, model: Model, *terms: EffectTerm) -> Diagnosis:
    findings = tuple(Finding(t, 0.98, 1.4, 0.05, 0.97, (), None, "said") for t in terms)
    rows = tuple(AxisResidual(a, "N·m", 1.4, 0.05, 0.049) for a in recording.axes)
    verdict = Verdict.EXPLAINED if terms else Verdict.CONSISTENT
    return Diagnosis(verdict, rows, 0.97, findings, None, model.extended(*terms))


@pytest.fixture(scope="module")
def friction() -> tuple[Recording, Truth, Model]:
    recording, truth = make(
        "coulomb_friction", (1, 1), {"torque": TORQUE}, seed=11, motors=2, masses=(2, 2), moves=False,
        noise=0.002, drive="smooth",
    )  # fmt: skip
    return recording, truth, Model("cell", "refined", truth.chains, ChainStd.unknown(truth.chains))


def coulomb(axis: str, torque: float = TORQUE) -> EffectTerm:
    return EffectTerm("coulomb_friction", axis, {"torque": Estimate(torque, 0.05, "N·m")}, "mass 1")


def test_friction_is_a_step_over_velocity_and_none_over_position(
    friction: tuple[Recording, Truth, Model],
) -> None:
    recording, _, model = friction
    (view,) = cause_views(recording, model, diagnosed(recording, model, coulomb(recording.axes[1])))
    sides = {s["what"]: s for s in view["sides"]}
    assert list(sides) == ["velocity", "position", "deflection"]
    assert view["own"] == "velocity"
    y, v, x = (np.array(sides[w][k]) for w, k in (("velocity", "y"), ("velocity", "x"), ("position", "x")))
    fast = np.abs(v) > 0.3 * np.abs(v).max()
    assert np.mean(np.sign(v[fast]) == np.sign(y[fast])) > 0.97
    assert np.median(np.abs(y[fast])) == pytest.approx(TORQUE, rel=0.15)
    assert abs(np.corrcoef(x, y)[0, 1]) < 0.5 * np.corrcoef(np.sign(v), y)[0, 1]
    assert sides["deflection"]["x_label"] == "deflection [rad]"
