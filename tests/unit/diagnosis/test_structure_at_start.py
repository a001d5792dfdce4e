"""A load with a mode that nobody declared: the structure is decided before any law is looked at."""

from __future__ import annotations

import numpy as np
import pytest
from linear_cell import LinearCell, record

from invid.diagnosis.unknown_forces.structure_at_start import begin_with_structure
from invid.identification.begun import begin_elastic
from invid.model.plant import Kind


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [5, 6])
def test_a_load_with_a_mode_comes_home_among_coupled_chains(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axis, mass, spring = int(rng.integers(3)), rng.uniform(1.5, 3.0), rng.uniform(500.0, 1500.0)
    cell = LinearCell(
        [[0.7, 2.0, 3.0], [4.0, 5.0, 4.0], [7.0, 8.0, 6.0]],
        [[1000.0, 2000.0], [3000.0, 4000.0], [5000.0, 6000.0]],
        [[0.5, 1.0], [1.5, 2.0], [2.5, 3.0]],
        {(0, 1): 1.0, (0, 2): 2.0, (1, 2): 3.0},
        {axis: (mass, spring, 1.0)},
    )
    hold = {"gain": np.full(3, 60.0), "damping": np.full(3, 6.0), "said": np.full(3, 60.0)}
    recording = record(cell, seed=seed, rate=500.0, in_drive=False, **hold)
    first = begin_elastic(recording, (3, 3, 3), start=begin_with_structure).first
    structure, plant = first.hypothesis.structure, first.numbers.plant
    assert structure.modes == (structure.load[axis],)
    assert plant.of_kind(Kind.MASS)[-1] == pytest.approx(mass, rel=0.02)
    assert plant.of_kind(Kind.SPRING)[-1] == pytest.approx(spring, rel=0.02)
    assert plant.of_kind(Kind.MASS)[list(structure.load)] == pytest.approx([3.0, 4.0, 6.0], rel=0.02)
