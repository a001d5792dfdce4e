"""Two structures of one machine: what both have stays what it was."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from invid.diagnosis.unknown_forces.structures import Addition, Base, FurtherMass, Mode
from invid.likelihood.unknown_forces.correspondence import Correspondence
from invid.likelihood.unknown_forces.forces import Spot, Spots, Where
from invid.likelihood.unknown_forces.plant import Plant, Structure


def test_a_mass_that_becomes_part_of_its_motor_is_no_place_of_its_own() -> None:
    longer, shorter = Structure((3, 2)), Structure((2, 2))
    moved = Correspondence(longer, shorter, (0, 0, 1, 2, 3))
    there = [moved.spot(spot) for spot in Spots.of(longer).spots]
    assert moved.spot(Spot(Where.MASS, 1)) is None
    assert all(spot in Spots.of(shorter).number for spot in there if spot is not None)


STRUCTURES = [Structure((2, 3)), Structure((1, 2, 2), (2,)), Structure((3, 2), (1, 4), base=True)]
ADDITIONS: list[Addition] = [Mode(0), FurtherMass(0), FurtherMass(1), Base()]


@pytest.mark.parametrize(("structure", "addition"), list(product(STRUCTURES, ADDITIONS)))
def test_what_a_longer_structure_shares_with_the_shorter_is_the_same_there_and_back(
    structure: Structure, addition: Addition
) -> None:
    if isinstance(addition, Base) and structure.base:
        pytest.skip("has one")
    rng = np.random.default_rng(len(structure.elements))
    plant = Plant.of_values(structure, rng.uniform(1.0, 2.0, len(structure.elements)))
    wider = addition.within(structure)
    there, back = Correspondence.of(structure, wider), Correspondence.of(wider, structure)
    gone = {k for k, at in enumerate(back.at) if at < 0}
    added = {e: 1.5 for e in wider.elements if {e.a, e.b} & gone and not e.joins_axes}
    moved = there.plant(plant, added)
    assert back.plant(moved, {}).values == pytest.approx(plant.values)
    for spot in Spots.of(structure).spots:
        new = there.spot(spot)
        assert new is not None
        assert back.spot(new) == spot
