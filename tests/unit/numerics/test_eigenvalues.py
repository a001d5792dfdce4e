"""Eigenvalues of what data made."""

from __future__ import annotations

import numpy as np
import pytest

from invid.modes.poles import relocate_poles
from invid.numerics.linear_algebra import eigenvalues


def test_they_are_those_of_a_companion_matrix() -> None:
    found = eigenvalues(np.array([[6.0, -11.0, 6.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    assert found is not None
    assert np.sort(found.real) == pytest.approx([1.0, 2.0, 3.0])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_matrix_that_is_not_finite_has_none(bad: float) -> None:
    assert eigenvalues(np.array([[1.0, bad], [0.0, 1.0]])) is None


def test_poles_stay_where_the_data_leave_no_finite_ones() -> None:
    w = np.linspace(1.0, 10.0, 40)
    start = np.array([-0.01 + 3.0j, -0.01 + 7.0j])
    response = np.full((40, 1), np.nan + 0j)
    assert np.array_equal(relocate_poles(w, response, np.ones((40, 1)), start, 5), start)
