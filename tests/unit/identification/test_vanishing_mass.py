"""A further mass that vanishes, or that no datum tells from a wall, is none, whatever residual it fits."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from invid.identification.model_order import choose_order
from invid.model.chains import CoupledChains

COSTS = {1: 5e6, 2: 7e5, 3: 3.4e5, 4: 2.3e5, 5: 1.8e5, 6: 4e5}
"""χ² of 100 degrees of freedom that a three-mass axis with a strong transmission error gave."""


@pytest.mark.parametrize(
    ("light", "unknown", "chosen"),
    [(1e-4, 0.01, 3), (0.5, 0.01, 4), (0.5, 1.5, 3)],
    ids=["goes to nothing", "is there", "may be a wall"],
)
def test_a_further_mass_that_is_none_ends_the_growth(
    monkeypatch: pytest.MonkeyPatch, light: float, unknown: float, chosen: int
) -> None:
    def fit_sizes(_spectra: Any, sizes: tuple[int, ...], *_: Any, **__: Any) -> Any:
        (n,) = sizes
        masses = np.ones(n)
        masses[3:] = light
        chains = CoupledChains.build([masses], [np.full(n - 1, 1e3)], [np.zeros(n - 1)], axes=("A1",))
        structure = SimpleNamespace(slices={"mass": slice(0, n)})
        relative = np.where(np.arange(n) >= 3, unknown, 0.01)
        covariance = np.diag(np.append((relative * masses) ** 2, np.zeros(n - 1)))
        problem = SimpleNamespace(dof=100)
        return SimpleNamespace(
            noise_cost=COSTS[n], problem=problem, chains=chains, structure=structure, covariance=covariance
        )

    monkeypatch.setattr("invid.identification.model_order.fit_sizes", fit_sizes)
    monkeypatch.setattr("invid.identification.model_order.measured_frf", lambda _: None)
    monkeypatch.setattr("invid.identification.model_order._fit_with_hidden_mode", lambda *_: None)
    monkeypatch.setattr("invid.identification.model_order.missing_mode", lambda _: None)
    found = choose_order([], ("A1",))
    assert found.sizes == (chosen,)
