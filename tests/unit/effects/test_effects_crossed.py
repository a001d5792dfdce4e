"""Every cause crossed with every use, from its derivatives to its experiment, on both kinds of machine."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hidden.generator import make
from large_motion import experiment
from large_motion import recording as recording_of
from test_extended_model import SIZES

from invid.clauses import cause_name
from invid.diagnosis.consequence import consequence_of, graded_sentence
from invid.diagnosis.sentences import finding_sentence
from invid.effects.catalogue.base_compliance import BaseCompliance
from invid.effects.effect_files import check_effect
from invid.effects.laws.empirical_law import EmpiricalLaw
from invid.effects.registry import BY_CAUSE, CATALOGUE, LARGE_MOTION, load_effects, registered_effects
from invid.effects.sizes import Machine
from invid.effects.units import unit_of
from invid.model.chains import CoupledChains
from invid.model.diagnosis_document import Consequence, Finding, Grade, load_model
from invid.model.document import ChainStd, EffectTerm, Estimate, Model
from invid.model.law_table import LawTable
from invid.recording.model import Recording
from invid.simulation.rigid import simulate_motion
from invid.simulation.run import simulate

FILES = Path(__file__).parents[2] / "effects"
FURTHER = [e for f in sorted(FILES.glob("*.py")) for e in load_effects(f)]
SIZE = {
    **SIZES,
    "quadratic_drag": ("mass 1", {"coefficient": 3.0}),
    "end_cushion": ("mass 1", {"stiffness": 30.0, "begin": 0.002}),
    "load_dependent_friction": ("mass 1", {"coefficient": 0.1, "inertia_counts": 0.0}),
    "quadratic_stiffness": ("spring 0", {"coefficient": 5.0}),
    "empirical_law": ("mass 1", {"torque": 2.0}),
}
ONE_LAW = LawTable(
    "velocity", (-0.5, 0.0, 0.5), "rad/s", (-2.0, 0.1, 1.0), "N·m", ((0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1))
)
TABLES = {"empirical_law": ONE_LAW}
ELASTIC = [BaseCompliance(2) if e.cause == "base_compliance" else e for e in (*CATALOGUE, *FURTHER)]
ELASTIC.append(EmpiricalLaw().known(EffectTerm("empirical_law", "J1", {}, table=ONE_LAW)))
EVERY = [*ELASTIC, *LARGE_MOTION]
"""All effects, and those that an elastic machine can have."""
NO_LARGE_MOTION = {
    "torque_lag", "torque_gain", "torque_saturation",
    "encoder_eccentricity", "dropped_samples", "spring_damping", "backlash", "spring_hysteresis",
    "transmission_error", "extra_mode", "coupling_stiffness", "base_compliance", "payload_change",
    "parameter_drift",
}  # fmt: skip
"""Causes that a rigid machine in large motion is not asked for."""
"""Causes whose missing torque is a function of no one quantity."""


@pytest.fixture(autouse=True)
def known():
    with registered_effects(FURTHER):
        yield


@pytest.fixture(scope="module")
def excited() -> tuple[Recording, CoupledChains]:
    recording, truth = make(None, seed=21, masses=(2, 3), noise=0.003, drive="smooth", moves=False, periods=2)
    return recording, truth.chains


def term_of(effect, axes) -> EffectTerm:
    element, values = SIZE[effect.cause]
    other = axes[1] if effect.cause == "coupling_stiffness" else None
    units = {name: unit_of(kind, False) for name, kind in effect.parameters.items()}
    parameters = {k: Estimate(v, 0.1 * abs(v), units[k]) for k, v in values.items()}
    return EffectTerm(effect.cause, axes[0], parameters, element, other, TABLES.get(effect.cause))


def model_of(chains: CoupledChains, *effects: EffectTerm) -> Model:
    return Model("cell", "refined", chains, ChainStd.unknown(chains), effects=effects)


def ids(effect) -> str:
    return effect.cause


def test_the_sizes_here_are_those_of_all_effects() -> None:
    assert sorted(SIZE) == sorted(e.cause for e in EVERY)
    assert sorted(BY_CAUSE) == sorted(e.cause for e in EVERY)


@pytest.mark.parametrize("effect", EVERY, ids=ids)
def test_what_it_declares_is_what_a_file_of_its_own_may_declare(effect) -> None:
    assert check_effect(effect, "catalogue") is effect


@pytest.mark.parametrize("effect", ELASTIC, ids=ids)
def test_it_is_saved_reloaded_and_simulated(effect, excited, tmp_path: Path) -> None:
    recording, chains = excited
    model = model_of(chains, term_of(effect, chains.axes))
    model.save(tmp_path / "model.json")
    loaded = load_model(tmp_path / "model.json")
    assert loaded.effects == model.effects
    first = recording.experiments[0].key
    answers = [simulate(m, recording, only=(first,)).experiments[0] for m in (model_of(chains), loaded)]
    assert np.isfinite(answers[1].position).all()
    assert np.abs(answers[1].position - answers[0].position).max() > 0.0


@pytest.mark.parametrize("effect", EVERY, ids=ids)
def test_it_is_said_in_a_sentence_with_size_place_and_check(effect, excited) -> None:
    _, chains = excited
    one = term_of(effect, chains.axes)
    sizes = chains.masses_per_branch
    text = finding_sentence(one, 0.9, 0.99, (), sizes, chains.axes)
    assert text.startswith(f"Axis {chains.axes[0]}: {effect.title}")
    found = Finding(one, 0.99, 0.4, 0.05, 0.9, sentence=text)
    assert graded_sentence(found, Consequence(Grade.WATCH, "", "")).endswith(f" {effect.check}")
    assert "±" in text
    assert cause_name(effect.cause) in effect.title
    doubtful = finding_sentence(one, 0.9, 0.5, (), sizes, chains.axes)
    assert effect.separating.text in doubtful


@pytest.mark.parametrize("effect", EVERY, ids=ids)
def test_what_it_means_is_graded_or_said_to_have_no_figure(effect, excited) -> None:
    _, chains = excited
    axes = chains.axes
    machine = Machine(chains, False, dict.fromkeys(axes, 10.0), dict.fromkeys(axes, 3.0), 20.0, {})
    found = consequence_of(term_of(effect, axes), machine)
    figured = any(s.expected is not None for s in effect.sizes)
    assert (found.source is not None) is figured
    assert all(np.isfinite(v) for v in found.measures.values())
    assert found.reason


@pytest.mark.parametrize("effect", EVERY, ids=ids)
def test_a_rigid_machine_simulates_it_or_says_that_it_cannot(effect) -> None:
    time = np.arange(400) / 200.0
    position = np.sin(2 * np.pi * 0.7 * time)
    chains = CoupledChains.build([[1.0]], [[]], ground_springs=[50.0], axes=["A1"])
    one = replace(term_of(effect, ("A1", "A1")), other_axis=None)
    if effect.cause == "cubic_stiffness":
        one = replace(one, element="spring 0")
    if effect.cause in ("gravity", "viscous_friction"):
        one = replace(one, element="mass 1")
    recording = recording_of(experiment(time, position[:, None], 5.0 * position[:, None]))
    model = Model("cell", "trajectory", chains, ChainStd.unknown(chains), effects=(one,))
    if effect.cause in NO_LARGE_MOTION:
        with pytest.raises(ValueError, match=effect.cause):
            simulate_motion(model, recording)
        return
    plain = simulate_motion(replace(model, effects=()), recording).experiments[0].position
    assert np.isfinite(simulate_motion(model, recording).experiments[0].position).all()
    if effect.cause != "load_dependent_friction":  # without a weight there is no load
        assert np.abs(simulate_motion(model, recording).experiments[0].position - plain).max() > 0.0
