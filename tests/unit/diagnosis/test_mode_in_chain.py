"""A chain whose light mass stands where the machine has a mode is made anew from its modes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from invid.diagnosis.rules.mode_in_chain import chain_parameters_with_mode
from invid.effects.catalogue.extra_mode import _peak_frequencies
from invid.effects.registry import BY_CAUSE
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.model.chains import CoupledChains
from invid.model.parameters import ChainStructure
from invid.model.place import Place

LINES = 2 * np.pi * np.arange(0.5, 12.0, 0.25)
MASSES, SPRINGS = np.array([1.0, 1.6, 0.7]), np.array([300.0, 500.0])


def _fitted(mode: PlacedEffect, masses: list[float], springs: list[float], x: list[float]) -> Any:
    """A fit of a chain of three masses with a mode beside it."""
    chains = CoupledChains.build([masses], [springs], [[0.5, 0.0]])
    structure = ChainStructure((3,), chains.axes, viscous=False)
    candidate = Candidate().plus(mode, np.array(x))
    layout = SimpleNamespace(structure=structure)
    return SimpleNamespace(layout=layout, p=structure.vector(chains), candidate=candidate)


def test_a_light_mass_gives_way_to_the_mode_that_was_found_beside_the_chain() -> None:
    # The third mass stands, as a mode, beside a chain whose own third mass is next to nothing.
    term = PlacedEffect(BY_CAUSE["extra_mode"], Place("mass", 0, 2))
    x = [float(MASSES[2]), 0.5 * float(np.log(SPRINGS[1] / MASSES[2])), float(np.log(0.01))]
    fitted = _fitted(term, [1.0, 1.6, 1e-4], [300.0, 2.0], x)
    record: Any = SimpleNamespace(omega=LINES, excited=np.ones(LINES.size, dtype=bool))
    p = chain_parameters_with_mode(fitted, [record])
    assert p is not None
    chains = fitted.layout.structure.chains(p)
    assert chains.masses[0] == pytest.approx(MASSES, rel=2e-3)
    assert chains.springs[0] == pytest.approx(SPRINGS, rel=2e-3)
    assert (chains.dampers[0] > 0).all()


def test_another_cause_is_no_mode_of_the_chain() -> None:
    term = PlacedEffect(BY_CAUSE["coulomb_friction"], Place("mass", 0, 2))
    fitted = _fitted(term, [1.0, 1.6, 0.7], [300.0, 500.0], [0.1])
    assert chain_parameters_with_mode(fitted, []) is None


def test_a_mode_is_looked_for_where_causes_found_before_leave_most() -> None:
    lines, certain = LINES.size, np.ones((LINES.size, 1, 1), dtype=complex)
    before, left = np.zeros((lines, 1), dtype=complex), np.zeros((lines, 1), dtype=complex)
    before[2:9], left[30:33] = 1.0, 0.1
    view: Any = SimpleNamespace(
        record=SimpleNamespace(excited=np.ones(lines, dtype=bool)),
        omega=LINES,
        condensed_force=lambda _: np.ones((lines, 1), dtype=complex),
        certainty=certain,
        missing=before,
        remaining=left,
    )
    assert _peak_frequencies([view], ((0, 1),))[0] == pytest.approx(LINES[31])
    view.remaining = None
    assert LINES[2] <= _peak_frequencies([view], ((0, 1),))[0] <= LINES[8]
