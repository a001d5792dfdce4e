"""What a diagnosis returns is no worse on the records kept out than what identification returned."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import invid
from hidden import aperiodic, cells, generator
from invid.diagnosis.known_effects import effect_place, effect_vector
from invid.diagnosis.linear_fit import axes_with_smoothed_torque, layout_of, start_vector
from invid.diagnosis.validation import split_records
from invid.effects.registry import effect_of
from invid.identification.identify import identify
from invid.likelihood.evaluation import evaluate
from invid.likelihood.nuisance.hold_share import find_inside_holds
from invid.likelihood.null_test import rms_torque
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.model.document import Model
from invid.model.parameters import ChainStructure
from invid.recording.model import Recording
from invid.signals.spectra import all_spectra

ROUNDING = 1.05
"""Share by which the worse may exceed the better where both are at the noise: a model document holds no share
of a hold and no initial state, which both lack."""
BUDGET_S = 60.0
"""The commands' own: what a search that is cut returns is held to it as well."""
Draw = Callable[[], tuple[Recording, Any]]
CASES: dict[str, Draw] = {
    "nothing": lambda: generator.make(None, seed=71, masses=(2,)),
    "dry friction": lambda: generator.make("coulomb_friction", seed=72, masses=(2,), target_db=20.0),
    "a stiffening spring": lambda: generator.make("cubic_stiffness", seed=73, masses=(2,), target_db=20.0),
    "no cause of the catalogue": lambda: generator.make("power_drag", seed=74, masses=(2,), target_db=25.0),
    "a cell of one axis": lambda: cells.draw(75, masses=(2,), faults=()),
    "a motion without periods": lambda: aperiodic.draw(3, "noise"),
    "free play": lambda: generator.make("backlash", seed=76, masses=(3,), target_db=25.0),
    "a mode": lambda: generator.make("extra_mode", seed=77, motors=2, target_db=25.0),
    "a coupling of two loads": lambda: generator.make("coupling_stiffness", seed=78, target_db=25.0),
    "a stop": lambda: generator.make("end_stop", seed=79, masses=(2,), target_db=25.0),
    "a cell of two axes": lambda: cells.draw(80, motors=2),
    "a cell of three axes": lambda: cells.draw(81, motors=3),
}


def missed(model: Model, recording: Recording) -> float:
    """Rms of the torque that a model misses on the records kept out, all axes together, nothing refitted."""
    spectra = all_spectra(recording)
    train, held, _ = split_records(recording, spectra)
    grounded = tuple(int(i) for i in np.flatnonzero(model.chains.ground_springs > 0))
    structure = ChainStructure(model.chains.masses_per_branch, model.axes, grounded=grounded)
    origin = min(float(e.time[0]) for e in recording.experiments)
    logged = train[0].command is not None
    holds = find_inside_holds(spectra, model, recording, with_command=logged)
    layout = layout_of(structure, train, origin, holds, () if logged else axes_with_smoothed_torque(model))
    candidate = Candidate()
    for term in model.effects:
        effect = effect_of(term.cause)
        assert effect is not None
        candidate = candidate.plus(
            PlacedEffect(effect.known(term), effect_place(term, structure)), effect_vector(term)
        )
    delayed = [t.place.axis for t in candidate.terms if t.effect.cause == "torque_delay"]
    layout, _ = layout.without_delay(delayed)
    found = evaluate(layout, held, start_vector(model, layout), candidate, jacobian=False)
    return float(np.hypot.reduce([rms_torque(found, i)[0] for i in range(structure.motors)]))


@pytest.mark.parametrize("case", CASES)
def test_a_diagnosis_returns_no_worse_a_model_than_identification(case: str) -> None:
    recording, _ = CASES[case]()
    model = identify(recording)
    found = invid.diagnose(recording, model=model, budget=BUDGET_S)
    assert missed(found.model, recording) <= ROUNDING * missed(model, recording)
