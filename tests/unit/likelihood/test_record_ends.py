"""Periods that do not close: what their ends add, with and without effects that are linear in motion."""

from __future__ import annotations

import numpy as np
import pytest
from two_masses import from_rest
from two_masses import recording as recording_of

from invid.diagnosis.linear_fit import layout_of
from invid.effects.catalogue.base_compliance import BaseCompliance
from invid.effects.catalogue.extra_mode import ExtraMode
from invid.effects.catalogue.parameter_drift import ParameterDrift
from invid.effects.catalogue.payload_change import PayloadChange
from invid.effects.catalogue.viscous_friction import ViscousFriction
from invid.likelihood.evaluation import evaluate
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.likelihood.prepare_records import spectral_record, split_into_periods
from invid.model.parameters import ChainStructure
from invid.model.place import Place
from invid.numerics.arrays import Float64
from invid.recording import Role
from invid.signals.spectra import spectra_of
from invid.signals.spectral_record import SpectralRecord

LONG_AGO = -1e7
"""Where the recording's time begins for a drift: then a stiffness stands still within a record."""


def periods() -> tuple[list[SpectralRecord], SpectralRecord]:
    """Two periods from rest of the axis, each for itself, and their mean."""
    experiment = from_rest(3, Role.IDENTIFY, "000")
    recording = recording_of(experiment)
    whole = spectral_record(spectra_of(experiment, drop_transient=False), experiment)
    return split_into_periods(recording, [whole], ["000"]), whole


def excess(
    record: SpectralRecord,
    candidate: Candidate,
    mass: float = 2.0,
    spring: float = 1000.0,
    rubbing: float = 0.0,
) -> float:
    """χ² of one period beyond what noise leaves, in standard deviations.

    At the true plant (which rubs nowhere), but for what ``candidate`` has to make up for.
    """
    structure = ChainStructure((2,), ("A1",), viscous=True)
    at = structure.slices
    p = np.zeros(structure.count)
    p[at["mass"]] = np.log([0.7, mass])
    p[at["spring"]] = np.log([spring])
    p[at["damper"]] = 0.5
    p[at["viscous"]] = rubbing
    return excess_of(structure, p, record, candidate)


def excess_of(
    structure: ChainStructure, plant: Float64, record: SpectralRecord, candidate: Candidate
) -> float:
    """The same at the parameters ``plant`` of a structure."""
    layout = layout_of(structure, [record], LONG_AGO)
    p = np.zeros(layout.count)
    p[: structure.count] = plant
    p[structure.count] = 0.5 * record.step  # the torque is held over each sample
    p[layout.zoh_slice] = 1.0
    found = evaluate(layout, [record], p, candidate, jacobian=False)
    return float((found.cost - found.dof) / np.sqrt(2 * found.dof))


def test_each_period_of_a_motion_from_rest_has_the_mean_torque_of_its_own() -> None:
    alone, whole = periods()
    experiment = from_rest(3, Role.IDENTIFY, "000")
    means = experiment.torque.reshape(2, -1).mean(axis=1)
    assert [r.torque[0, 0].real for r in alone] == pytest.approx(means, abs=1e-12)
    assert abs(means[0] - whole.torque[0, 0].real) > 1e-3
    for record in alone:
        assert abs(excess(record, Candidate())) < 5.0


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("cause", ["stiffness", "mass", "friction"])
def test_an_effect_that_is_linear_in_motion_makes_up_for_the_same_error_of_the_plant(
    cause: str, number: int
) -> None:
    record = periods()[0][number]
    middle = 0.5 * (record.start_time + record.end_time) - LONG_AGO
    term, x, wrong = {
        "stiffness": (
            PlacedEffect(ParameterDrift(), Place("spring", 0, 1)),
            [100.0 / middle],
            {"spring": 900.0},
        ),
        "mass": (PlacedEffect(PayloadChange(), Place("mass", 0, 2)), [0.3, LONG_AGO], {"mass": 1.7}),
        "friction": (PlacedEffect(ViscousFriction(), Place("mass", 0, 1)), [0.8], {"rubbing": -0.8}),
    }[cause]
    assert excess(record, Candidate(), **wrong) > 30.0
    assert abs(excess(record, Candidate((term,), (np.array(x),)), **wrong)) < 5.0


@pytest.mark.parametrize("number", [0, 1])
def test_two_such_effects_at_one_load_answer_to_each_other(number: int) -> None:
    """Each took the jumps as if it were alone: at the resonance of the load ten times the noise was left."""
    record = periods()[0][number]
    heavier = PlacedEffect(PayloadChange(), Place("mass", 0, 2))
    rubbing = PlacedEffect(ViscousFriction(), Place("mass", 0, 2))
    both = Candidate((heavier, rubbing), (np.array([0.8, LONG_AGO]), np.array([0.0])))
    assert abs(excess(record, both, mass=1.2)) < 5.0
    braked = Candidate((heavier, rubbing, rubbing), (both.x[0], np.array([2.0]), np.array([-2.0])))
    assert excess(record, braked, mass=1.2) == pytest.approx(excess(record, both, mass=1.2), abs=0.01)


@pytest.mark.parametrize("number", [0, 1])
def test_the_mass_of_a_mode_has_ends_of_its_own(number: int) -> None:
    """The load of the plant as a mode beside its motor: the same machine."""
    motor = ChainStructure((1,), ("A1",), viscous=True)
    plant = np.zeros(motor.count)
    plant[motor.slices["mass"]] = np.log([0.7])
    mass, spring, damper = 2.0, 1000.0, 0.5
    shape = [0.5 * np.log(spring / mass), np.log(0.5 * damper / np.sqrt(mass * spring))]
    mode = Candidate((PlacedEffect(ExtraMode(), Place("mass", 0, 1)),), (np.array([mass, *shape]),))
    record = periods()[0][number]
    assert abs(excess_of(motor, plant, record, mode)) < 5.0
    lighter = Candidate(mode.terms, (np.array([0.98 * mass, *shape]),))
    assert excess_of(motor, plant, record, lighter) > 30.0


@pytest.mark.parametrize("number", [0, 1])
def test_a_base_under_one_axis_is_a_mode_at_its_load_and_has_ends_of_its_own(number: int) -> None:
    """The load of the plant as what a base does to a motor that is heavier by the load."""
    motor = ChainStructure((1,), ("A1",), viscous=True)
    plant = np.zeros(motor.count)
    mass, spring, damper = 2.0, 1000.0, 0.5
    plant[motor.slices["mass"]] = np.log([0.7 + mass])
    shape = [0.5 * np.log(spring / mass), np.log(0.5 * damper / np.sqrt(mass * spring))]
    base = Candidate((PlacedEffect(BaseCompliance(), Place("base", 0)),), (np.array([mass, *shape]),))
    record = periods()[0][number]
    assert abs(excess_of(motor, plant, record, base)) < 5.0
    lighter = Candidate(base.terms, (np.array([0.98 * mass, *shape]),))
    assert excess_of(motor, plant, record, lighter) > 30.0


def test_the_ends_of_a_modes_mass_are_in_the_derivatives() -> None:
    motor = ChainStructure((1,), ("A1",), viscous=True)
    record = periods()[0][0]
    layout = layout_of(motor, [record], LONG_AGO)
    p = np.zeros(layout.count)
    p[motor.slices["mass"]] = np.log([0.8])
    p[motor.count], p[layout.zoh_slice] = 0.5 * record.step, 1.0
    terms = (PlacedEffect(ExtraMode(), Place("mass", 0, 1)),)

    def cost(x: Float64) -> float:
        return evaluate(layout, [record], p, Candidate(terms, (x,)), jacobian=False).cost

    x = np.array([1.5, np.log(22.0), np.log(0.01)])
    here = evaluate(layout, [record], p, Candidate(terms, (x,)))
    gradient = 2.0 * here.jacobian[:, -3:].T @ here.residual
    for k, h in enumerate((1e-5, 1e-6, 1e-4)):
        step = np.zeros(3)
        step[k] = h
        assert gradient[k] == pytest.approx((cost(x + step) - cost(x - step)) / (2 * h), rel=0.02)
