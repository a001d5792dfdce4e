"""Derivatives of laws solved for at once are those by differences."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from hidden.generator import make

from invid.diagnosis.linear_fit import layout_of
from invid.diagnosis.validation import split_records, unfold_periods
from invid.effects.registry import BY_CAUSE
from invid.likelihood import evaluation
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.model.parameters import ChainStructure
from invid.model.place import Place
from invid.signals.spectra import all_spectra

PLAY = (PlacedEffect(BY_CAUSE["backlash"], Place("spring", 1, 1)), np.array([np.log(1e-4)]))
GEAR = (PlacedEffect(BY_CAUSE["transmission_error"], Place("spring", 1, 2)), np.array([2e-4, -3e-4, 1.2]))


@pytest.mark.parametrize("law", [PLAY, GEAR])
def test_a_law_of_a_spring_beside_friction_answers_as_differences_say(law, monkeypatch) -> None:
    solved, differences = _both(monkeypatch, law, whole=False)
    size = np.linalg.norm(differences, axis=0)
    seen = size > 0.0
    off = np.linalg.norm(solved - differences, axis=0)[seen] / size[seen]
    assert np.median(off) < 0.005
    assert off.max() < 0.02  # differences take two or three substitutions


@pytest.mark.parametrize("law", [PLAY, GEAR])
def test_so_it_does_in_a_record_that_does_not_close(law, monkeypatch) -> None:
    solved, differences = _both(monkeypatch, law, whole=True)
    size = np.linalg.norm(differences, axis=0)
    seen = size > 0.0
    off = np.linalg.norm(solved - differences, axis=0)[seen] / size[seen]
    assert np.median(off) < 0.02
    assert off.max() < 0.1


def _both(monkeypatch, law, *, whole: bool) -> tuple[np.ndarray, np.ndarray]:
    """The Jacobian of a law beside friction, solved at once and by differences."""
    recording, truth = make(None, seed=21, masses=(2, 3), noise=0.003, drive="smooth", moves=False, periods=2)
    recording = unfold_periods(recording) if whole else recording
    chains = truth.chains
    train, _, _ = split_records(recording, all_spectra(recording))
    assert train[0].transient == whole
    structure = ChainStructure(chains.masses_per_branch, chains.axes, viscous=False)
    layout = layout_of(structure, train, 0.0)
    p = np.full(layout.count, 0.5)
    p[: structure.count] = structure.vector(chains)
    p[structure.count : structure.count + structure.motors] = 0.5 * layout.step
    terms = (
        PlacedEffect(BY_CAUSE["coulomb_friction"], Place("mass", 0, 1)),
        PlacedEffect(BY_CAUSE["cogging"], Place("mass", 1, 1)),
        law[0],
    )
    x = (np.array([0.05]), np.array([0.02, 0.01, 6.0]), law[1])
    candidate = Candidate(terms, x)
    here = evaluation.evaluate(layout, train, p, candidate, jacobian=False)
    solved = evaluation.add_jacobian(here, layout, p, candidate, thorough=True).jacobian
    monkeypatch.setattr(evaluation, "response_columns", lambda *_, **__: False)
    differences = evaluation.add_jacobian(here, layout, p, candidate, thorough=True).jacobian
    return solved, differences
