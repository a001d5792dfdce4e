"""Bases of columns: as many as there are directions, none where a record's piece has no line in the band."""

from __future__ import annotations

import numpy as np
import pytest

from invid.numerics.whitening import factored


@pytest.mark.parametrize(("rows", "rank"), [(0, 0), (1, 1), (9, 3)])
def test_a_basis_spans_the_columns_and_has_as_many_vectors_as_they_have_directions(
    rows: int, rank: int
) -> None:
    columns = np.random.default_rng(1).standard_normal((rows, 3))
    basis, back = factored(columns)
    assert basis.shape == (rows, rank)
    assert back.shape == (3, rank)
    assert basis.T @ basis == pytest.approx(np.eye(rank), abs=1e-12)
    assert columns @ back == pytest.approx(basis, abs=1e-12)
