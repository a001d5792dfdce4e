"""Tails against scipy.stats, which the product does not load."""

from __future__ import annotations

import pytest
from scipy import stats

from invid.numerics import distributions as d


@pytest.mark.parametrize("p", [0.4, 0.01, 1e-6, 1e-9])
def test_tails_agree_with_scipy_stats(p: float) -> None:
    assert d.normal_isf(p) == pytest.approx(stats.norm.isf(p), rel=1e-9, abs=1e-12)
    for dof in (1, 3, 40, 900):
        assert d.chi2_isf(p, dof) == pytest.approx(stats.chi2.isf(p, dof), rel=1e-8)
        assert d.f_isf(p, dof, 17) == pytest.approx(stats.f.isf(p, dof, 17), rel=1e-7)


def test_chances_agree_with_scipy_stats() -> None:
    assert d.chi2_sf(60.0, 20) == pytest.approx(stats.chi2.sf(60.0, 20), rel=1e-10)
    assert d.f_sf(2.5, 8, 100) == pytest.approx(stats.f.sf(2.5, 8, 100), rel=1e-10)
    for k in (-1, 0, 4, 10):
        assert d.binomial_sf(k, 10, 0.1) == pytest.approx(stats.binom.sf(k, 10, 0.1), rel=1e-9, abs=1e-300)
