"""The regression of a cause fitted from the truth stays there and leaves the noise.

Causes are ranked by it, and the quick sample of ``test_hidden_effects`` holds one of each family only: these
are others. Plant, law and integration are this folder's own.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from invid.diagnosis.known_effects import effect_place, effect_vector
from invid.diagnosis.linear_fit import fit_linear_model, layout_of
from invid.diagnosis.validation import split_records
from invid.effects.registry import BY_CAUSE
from invid.likelihood.joint_fit import fit
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.likelihood.prepare_records import spectral_record
from invid.model.document import EffectTerm, Estimate, Model, std_by_name
from invid.model.parameters import ChainStructure
from invid.recording import Role
from invid.signals.spectra import all_spectra

sys.path.insert(0, str(Path(__file__).parents[1]))
from hidden.generator import make, make_case

SIZES = {
    "stribeck_friction": {"static": 0.0713, "coulomb": 0.0497, "velocity": 0.174},
    "asymmetric_friction": {
        "coulomb_positive": 0.0181,
        "coulomb_negative": 0.0579,
        "viscous_positive": 0.0587,
        "viscous_negative": 0.0366,
    },
    "encoder_eccentricity": {"amplitude": 0.0404, "phase": 1.55},
    "coupling_stiffness": {"stiffness": 0.119},
    "parameter_drift": {"rate": -0.0833},
}
"""About 25 dB over the noise on the plant of the seed."""


@pytest.mark.parametrize("cause", SIZES)
def test_a_cause_fitted_to_a_plant_that_has_it_keeps_its_true_size_and_leaves_the_noise(cause: str) -> None:
    recording, truth = make(
        cause, size=SIZES[cause], seed=31, masses=(2, 2), noise=0.003, drive="smooth", from_rest=False,
        moves=False, periods=2, torque_quantised=False,
    )  # fmt: skip
    (true,) = truth.effects
    parameters = {k: Estimate(v) for k, v in true.parameters.items()}
    if cause == "parameter_drift":
        parameters["parameter"] = Estimate(1.0)
    term = EffectTerm(cause, true.axis, parameters, true.element, true.other_axis)
    structure = ChainStructure(truth.chains.masses_per_branch, truth.chains.axes, viscous=False)
    experiments = {e.key: e for e in recording.experiments}
    records = [spectral_record(s, experiments[s.key]) for s in all_spectra(recording, Role.IDENTIFY)]
    layout = layout_of(structure, records, 0.0)  # a drift of the plant begins at time 0
    p = np.zeros(layout.count)
    p[: structure.count] = structure.vector(truth.chains)
    place = effect_place(term, structure)
    candidate = Candidate().plus(PlacedEffect(BY_CAUSE[cause], place), effect_vector(term))
    without = fit(layout, records, p, Candidate(), iterations=8)
    found = fit(layout, records, p, candidate, iterations=8)
    assert without.cost > 50.0 * without.dof
    assert found.cost < 1.3 * found.dof
    values = BY_CAUSE[cause].values(found.candidate.x[0].tolist(), place)
    for name, value in true.parameters.items():
        # The corner of Stribeck's curve is the least known: to a twelfth.
        assert values[name] == pytest.approx(value, rel=0.12 if name == "velocity" else 0.03), name


def test_a_gap_beside_a_late_torque_leaves_the_noise() -> None:
    """What the late torque leaves is no force in the spring: taken for one, it let the noise at the clamped
    resonance through, and the two left 7 times the noise at their true sizes."""
    recording, truth = make_case(930017)
    terms = tuple(
        EffectTerm(e.cause, e.axis, {k: Estimate(v) for k, v in e.parameters.items()}, e.element)
        for e in truth.effects
    )
    known = std_by_name(truth.chains, {})
    fitted = {"joint_with_effects": True}
    model = Model("test", "refined", truth.chains, known, effects=terms, fit=fitted)
    spectra = all_spectra(recording)
    train, held, _ = split_records(recording, spectra)
    found, *_ = fit_linear_model(model, recording, spectra, train, held)
    assert found.cost < 1.3 * found.dof


def test_a_lag_gains_nothing_by_taking_the_torques_noise_away() -> None:
    """At 20 % of noise one of 0.8 ms was named where there is none: its weights were the record's."""
    recording, truth = make(
        None, seed=31, masses=(2,), noise=0.2, drive="smooth", from_rest=False, moves=False, periods=4,
        torque_quantised=False,
    )  # fmt: skip
    structure = ChainStructure(truth.chains.masses_per_branch, truth.chains.axes, viscous=False)
    experiments = {e.key: e for e in recording.experiments}
    records = [spectral_record(s, experiments[s.key]) for s in all_spectra(recording, Role.IDENTIFY)]
    layout = layout_of(structure, records, 0.0)
    p = np.zeros(layout.count)
    p[: structure.count] = structure.vector(truth.chains)
    without = fit(layout, records, p, Candidate(), iterations=25)
    lag = BY_CAUSE["torque_lag"]
    start = Candidate((PlacedEffect(lag, lag.places(structure)[0]),), (np.array([np.log(records[0].step)]),))
    beside = fit(layout, records, without.p, start, iterations=40)
    assert without.cost - beside.cost < 10.0
