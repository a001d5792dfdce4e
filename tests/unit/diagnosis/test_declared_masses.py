"""A mode beside a chain taken into it."""

from __future__ import annotations

import numpy as np
import pytest

from invid.diagnosis.rules.declared_masses import _longer
from invid.model.chains import CoupledChains


@pytest.mark.parametrize("at", [0, 1])
def test_a_chain_with_a_mode_in_it_answers_alike_at_the_motor(at: int) -> None:
    chains = CoupledChains.build([[4.0, 5.5]], [[4400.0]], [[0.0]])
    longer = _longer(chains, 0, at, 0.02, 1900.0)
    assert longer.masses_per_branch == (3,)
    assert longer.masses[0][0] == pytest.approx(4.0)
    assert longer.masses[0].sum() == pytest.approx(9.52)
    for omega in 2 * np.pi * np.array([2.0, 6.0, 20.0, 45.0, 52.0]):
        own = np.diag([4.0, 5.5, 0.02]) * -(omega**2) + 0j
        for i, j, k in ((0, 1, 4400.0), (at, 2, 1900.0)):
            own[[i, j], [i, j]] += k
            own[i, j] -= k
            own[j, i] -= k
        masses, springs = longer.masses[0], longer.springs[0]
        other = np.diag(masses) * -(omega**2) + 0j
        for j, k in enumerate(springs):
            other[[j, j + 1], [j, j + 1]] += k
            other[j, j + 1] -= k
            other[j + 1, j] -= k
        assert np.linalg.inv(other)[0, 0] == pytest.approx(np.linalg.inv(own)[0, 0], rel=1e-8)
