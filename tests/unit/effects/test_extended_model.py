"""A model with effects is a model like any other: saved, loaded, simulated, compared, diagnosed again."""

import dataclasses

import numpy as np
import pytest
from hidden.generator import make

from invid.diagnosis.diagnose import diagnose
from invid.errors import InputError
from invid.model.chains import CoupledChains
from invid.model.diagnosis_document import Verdict
from invid.model.document import (
    ChainStd,
    EffectTerm,
    Estimate,
    Model,
)
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.simulation.run import simulate

CHAINS = CoupledChains.build(
    [[1.0, 1.5], [2.0, 3.0, 1.0]],
    [[800.0], [1500.0, 2500.0]],
    [[1.0], [1.5, 2.0]],
    [[0, 0.6], [0.6, 0]],
    axes=["A1", "A2"],
)
SIZES = {
    "coulomb_friction": ("mass 1", {"torque": 0.4}),
    "viscous_friction": ("mass 2", {"coefficient": 0.3}),
    "stribeck_friction": ("mass 1", {"static": 0.6, "coulomb": 0.4, "velocity": 0.02}),
    "presliding_friction": ("mass 1", {"stiffness": 300.0, "torque": 0.3}),
    "asymmetric_friction": (
        "mass 1",
        {"coulomb_positive": 0.4, "coulomb_negative": 0.3, "viscous_positive": 0.2, "viscous_negative": 0.1},
    ),
    "torque_offset": ("mass 1", {"torque": 0.2}),
    "cogging": ("mass 1", {"torque": 0.3, "cycles_per_rev": 24.0, "phase": 0.7}),
    "torque_delay": (None, {"delay": 0.004}),
    "torque_lag": (None, {"time_constant": 0.003}),
    "torque_gain": (None, {"gain": 1.1}),
    "torque_saturation": (None, {"limit": 2.0}),
    "encoder_eccentricity": (None, {"amplitude": 1e-4, "phase": 0.5}),
    "dropped_samples": (None, {"fraction": 0.05}),
    "spring_damping": ("spring 1", {"coefficient": 0.7}),
    "cubic_stiffness": ("spring 1", {"coefficient": 4e6}),
    "backlash": ("spring 1", {"gap": 1e-3}),
    "spring_hysteresis": ("spring 1", {"stiffness": 200.0, "torque": 0.2}),
    "transmission_error": ("spring 1", {"amplitude": 1e-4, "cycles_per_rev": 30.0, "phase": 0.4}),
    "gravity": ("mass 2", {"torque": 0.8, "angle": 0.3}),
    "extra_mode": ("mass 2", {"mass": 0.2, "stiffness": 900.0, "damping_ratio": 0.02}),
    "coupling_stiffness": (None, {"stiffness": 100.0}),
    "base_compliance": (
        None,
        {"mass": 4.0, "stiffness": 900.0, "damping_ratio": 0.02, "share_1": 1.0, "share_2": 0.6},
    ),
    "payload_change": ("mass 2", {"mass": 0.3, "time": 2.0}),
    "parameter_drift": ("spring 1", {"parameter": 1.0, "rate": -20.0}),
}


def extended(*effects: EffectTerm) -> Model:
    return Model("cell", "refined", CHAINS, ChainStd.unknown(CHAINS), effects=effects)


@pytest.fixture(scope="module")
def excited() -> Recording:
    """Six seconds of torque and a motion that is not the model's: only the drift is kept near it."""
    time = np.arange(1500) / 250.0
    lines = np.array([1.0, 1.5, 2.5, 3.5])
    phase = np.random.default_rng(5).uniform(0, 2 * np.pi, (2, lines.size))
    torque = 1.5 * np.sin(2 * np.pi * lines * time[:, None, None] + phase).sum(axis=-1)
    one = Experiment(
        key="000",
        kind=Kind.MULTISINE,
        role=Role.IDENTIFY,
        excited_axis=-1,
        hold_gain=np.zeros(2),
        period_samples=500,
        frequencies_hz=lines,
        sample_rate_hz=250.0,
        time=time,
        position=0.01 * np.sin(2 * np.pi * time)[:, None] * np.ones(2),
        torque=torque,
    )
    return Recording(
        robot="cell",
        axes=("A1", "A2"),
        position_unit="rad",
        torque_unit="N·m",
        created="2026-01-01T00:00:00Z",
        experiments=(one,),
    )


@pytest.mark.campaign
def test_friction_that_has_gone_since_comes_out_as_nothing_and_nothing_takes_its_place() -> None:
    recording, _ = make("coulomb_friction", seed=11, motors=1, target_db=20)
    wrong = diagnose(recording).model
    nothing = make(None, seed=11, motors=1)[0]
    # the friction that the model carries is gone: it comes out as nothing, and no other cause in its stead
    d = diagnose(nothing, model=dataclasses.replace(wrong, provenance={}))
    assert d.verdict is Verdict.CONSISTENT
    assert d.findings == ()


def test_motion_that_runs_away_beyond_all_numbers_is_said_and_no_traceback(excited: Recording) -> None:
    away = EffectTerm("viscous_friction", "A1", {"coefficient": Estimate(-2e4, None)}, "mass 1")
    with np.errstate(all="ignore"), pytest.raises(InputError, match="a million times"):
        simulate(extended(away), excited)
