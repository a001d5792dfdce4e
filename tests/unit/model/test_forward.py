"""The forward model against dense linear algebra written out here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from invid.errors import InputError
from invid.model.chains import CoupledChains
from invid.model.forward import frf
from invid.model.matrices import Condensed


def test_motors_see_what_dense_matrices_written_by_hand_give() -> None:
    masses, springs, dampers = [[2.0], [1.0, 3.0, 4.0]], [[], [700.0, 900.0]], [[], [1.5, 0.5]]
    chains = CoupledChains.build(
        masses, springs, dampers, [[0.0, 1.2], [1.2, 0.0]], ground_springs=[30.0, 60.0]
    )
    chains = replace(chains, ground_dampers=np.array([0.3, 0.6]))
    m = np.array([[2.0, 0, 0, 1.2], [0, 1.0, 0, 0], [0, 0, 3.0, 0], [1.2, 0, 0, 4.0]])
    k = np.array([[30.0, 0, 0, 0], [0, 760.0, -700.0, 0], [0, -700.0, 1600.0, -900.0], [0, 0, -900.0, 900.0]])
    c = np.array([[0.3, 0, 0, 0], [0, 2.1, -1.5, 0], [0, -1.5, 2.0, -0.5], [0, 0, -0.5, 0.5]])
    omega = np.linspace(0.5, 60.0, 40)
    seen = Condensed.of(chains.matrices.dynamic_stiffness(1j * omega), [0, 1])
    for f, w in enumerate(omega):
        full = k + 1j * w * c - w**2 * m
        inner = -np.linalg.solve(full[2:, 2:], full[2:, :2])
        np.testing.assert_allclose(seen.motion[f].T, np.vstack([np.eye(2), inner]), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(frf(chains, [w])[0], np.linalg.inv(full)[:2, :2], rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(seen.stiffness[f], np.linalg.inv(frf(chains, [w])[0]), rtol=1e-7)


def test_an_undamped_resonance_has_no_receptance() -> None:
    chains = CoupledChains.build([[1.0, 1.0]], [[200.0]])
    with pytest.raises(InputError, match="undamped resonance"):
        frf(chains, [20.0])
