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


def test_beside_an_antiresonance_a_record_from_rest_shows_the_friction_and_not_its_own_ringing() -> None:
    # Motor position and torque of two masses with friction at the motor, shaken from rest: what the record
    # does not end with as it began is fitted beside the cause, never in its stead.
    from two_masses import DAMPER, MASS, SPRING
    from two_masses import recording as recorded

    from invid.model.chains import CoupledChains
    from invid.recording.model import Experiment, Kind, Role

    rate, count, fine = 1000.0, 2048, 10
    lines = np.arange(1, 25, 2) / (count / rate)  # 3.56 Hz, the antiresonance, lies among them
    time = np.arange(2 * count) / rate
    phases = 2 * np.pi * np.random.default_rng(3).uniform(size=lines.size)
    push = 4.0 * np.cos(2 * np.pi * lines * time[:, None] + phases).sum(axis=1)
    push *= np.minimum(1.0, time / 0.2)
    q, v, h = np.zeros(2), np.zeros(2), 1.0 / rate / fine
    position, torque = np.empty(time.size), np.empty(time.size)
    for n, wanted in enumerate(push):
        position[n] = q[0]
        torque[n] = wanted - 60.0 * q[0] - 12.0 * v[0]
        for _ in range(fine):
            across = SPRING * (q[0] - q[1]) + DAMPER * (v[0] - v[1])
            resisted = TORQUE * np.tanh(v[0] / 1e-3)
            v += h * np.array([torque[n] - across - resisted, across]) / MASS
            q += h * v
    rng = np.random.default_rng(4)
    experiment = Experiment(
        key="000", kind=Kind.MULTISINE, excited_axis=0, role=Role.VALIDATE, hold_gain=np.zeros(1),
        period_samples=count, frequencies_hz=lines, sample_rate_hz=rate, time=time[count:],
        position=position[count:, None] + 1e-6 * rng.normal(size=(count, 1)),
        torque=torque[count:, None] + 0.05 * rng.normal(size=(count, 1)),
    )  # fmt: skip
    recording = recorded(experiment)
    chains = CoupledChains((MASS,), (np.array([SPRING]),), (np.array([DAMPER]),))
    model = Model("two masses", "refined", chains, ChainStd.unknown(chains))
    (view,) = cause_views(recording, model, diagnosed(recording, model, coulomb("A1")))
    missing, left = (float(np.sqrt(np.mean(np.square(view["spectrum"][k])))) for k in ("missing", "left"))
    assert left < 0.25 * missing
