"""Tails of the few distributions the tests use, from ``scipy.special``.

``scipy.stats`` has them too, but takes seconds to import, which every command would pay.
"""

from __future__ import annotations

import numpy as np
from scipy import special


def normal_isf(p: float) -> float:
    """The z that a standard normal exceeds with chance p."""
    return float(-special.ndtri(p))


def chi2_sf(x: float, dof: float) -> float:
    """Chance that χ² with ``dof`` degrees of freedom exceeds x."""
    return float(special.chdtrc(dof, max(x, 0.0)))


def chi2_isf(p: float, dof: float) -> float:
    """The value that χ² with ``dof`` degrees of freedom exceeds with chance p."""
    return float(special.chdtri(dof, p))


def f_sf(x: float, numerator: float, denominator: float) -> float:
    """Chance that F exceeds x."""
    return float(special.fdtrc(numerator, denominator, max(x, 0.0)))


def f_isf(p: float, numerator: float, denominator: float) -> float:
    """The value that F exceeds with chance p (by 1/F, whose lower tail keeps its digits)."""
    return float(1.0 / special.fdtri(denominator, numerator, p))


def binomial_sf(k: int, n: int, p: float) -> float:
    """Chance of more than k successes in n trials."""
    if k < 0:
        return 1.0
    return float(special.bdtrc(k, n, p)) if k < n else 0.0


def binomial_isf(p: float, n: int, share: float) -> int:
    """The smallest k that n trials exceed with a chance of at most p."""
    return int(np.argmax(special.bdtrc(np.arange(n + 1), n, share) <= p))
