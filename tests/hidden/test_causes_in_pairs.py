"""Causes beside others: found again where those that were missing are in place."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from invid.diagnosis.diagnose import diagnose

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.generator import make, make_case
from hidden.scoring import score
from invid.recording.model import Recording


def test_gravity_that_looked_like_a_ripple_while_friction_was_missing_is_no_ripple_beside_it() -> None:
    recording, _ = make_case(750011)
    findings = diagnose(recording).findings
    assert {f.effect.cause for f in findings} & {"presliding_friction"}
    # On so small a motion a constant torque is the same data, and which of the two comes first is chance.
    (position,) = (f for f in findings if f.effect.cause != "presliding_friction")
    assert position.effect.cause in ("gravity", "torque_offset")
    assert {position.effect.cause, *(a.cause for a in position.alternatives)} >= {"gravity", "torque_offset"}
    assert position.confidence < 0.8


def test_a_limit_that_cuts_a_held_demand_beside_a_hold_that_goes_on_is_known_as_well_as_it_is_said() -> None:
    recording, truth = make_case(740022)
    result = score(truth, diagnose(recording))
    assert result.outcome == "right", result.named
    assert result.size_sigmas is not None
    assert abs(result.size_sigmas) < 3.0


def _bearing(recording: Recording, torque: list[float]) -> Recording:
    """The machine under a constant torque on every axis as well."""
    return replace(
        recording,
        experiments=tuple(
            replace(e, torque=e.torque + np.array(torque), torque_demand=None) for e in recording.experiments
        ),
    )


def test_a_constant_torque_twice_the_friction_beside_it_is_no_rounded_friction_of_one_direction() -> None:
    """Together they look one-sided; rounded for that, friction was half too large at 3 times the floor."""
    recording, truth = make(
        "coulomb_friction",
        (0, 1),
        seed=4,
        target_db=22,
        masses=(2,),
        periods=2,
        moves=False,
        from_rest=False,
        noise=0.003,
    )
    dry = truth.effects[0].parameters["torque"]
    found = diagnose(_bearing(recording, [2.0 * dry]))
    assert found.residual[0].after < 1.2 * found.residual[0].noise_floor
    sizes = {f.effect.cause: f.effect.value("torque") for f in found.findings}
    assert sizes == pytest.approx({"torque_offset": 2.0 * dry, "coulomb_friction": dry}, rel=0.03)


def test_a_weight_a_thousand_times_the_noise_hides_no_friction() -> None:
    """A robot arm: what its constant torque took away was the measure of every further cause."""
    recording, truth = make(
        "coulomb_friction",
        second="coulomb_friction",
        seed=3,
        target_db=15,
        masses=(2, 2),
        periods=2,
        moves=False,
        from_rest=False,
        noise=0.003,
    )
    weight = 8.0 * max(float(e.torque.std(axis=0).max()) for e in recording.experiments)
    findings = diagnose(_bearing(recording, [0.0, weight])).findings
    named = {(f.effect.cause, f.effect.axis) for f in findings}
    assert named == {("torque_offset", "Y"), ("coulomb_friction", "X"), ("coulomb_friction", "Y")}
    for f in findings:
        if f.effect.cause == "coulomb_friction":
            (true,) = (e for e in truth.effects if e.axis == f.effect.axis)
            assert f.effect.value("torque") == pytest.approx(true.parameters["torque"], rel=0.1)
