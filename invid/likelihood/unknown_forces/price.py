"""The price of a cause: the fall of −2 ln L that it must bring.

On records of a machine that the model fits, the largest fall that k numbers bring in n tries passes the
quantile of χ² at ``ALARM``/n with the probability ``ALARM`` (Bonferroni). No model is the machine: what ours
misses falls as well, and that is added as it was seen where nothing was hidden.
"""

from __future__ import annotations

from functools import cache

from invid.numerics.distributions import chi2_isf

ALARM = 0.01
"""Probability of a cause in one diagnosis of a machine that has none."""
TRIES, PARTS, PLACES = 3000, 20, 30
"""Laws, places and shapes of one search, parts of friction, and places at which a force without a name may
act: of three axes with three masses."""
ERROR = 98.0
"""What the form of friction and the grid of motion bring besides, on all records (empirical: false falls of
up to 120 in sixty rounds of whole cells of another hand)."""
ERROR_AT_MOTORS = 28.0
"""The same of what acts at motors, where an encoder's rounding and friction's own shape are all that is
missing (empirical: up to 31, nothing hidden)."""
FITTED, KEPT = 1 / 3, 1 / 12
"""Shares of a price that the records fitted and those kept out have to bring each (empirical)."""
NUMBER = 10.0
"""What a further number costs where hypotheses are compared by their odds: Schwarz's, of 10⁴ rows."""


@cache
def chance(numbers: int, tries: int) -> float:
    """Fall of −2 ln L that the best of so many tries with so many numbers passes by chance."""
    return chi2_isf(ALARM / tries, numbers)


def price(numbers: int = 1) -> float:
    """Fall on all records for a cause of so many numbers that a search over places and shapes came to."""
    return chance(numbers, TRIES) + ERROR


def price_at_motors(tries: int, numbers: int = 1) -> float:
    """Fall for a term of a motor, or for a force that acts somewhere, of so many tries."""
    return chance(numbers, tries) + ERROR_AT_MOTORS


def pays(fitted: float, kept: float, least: float) -> bool:
    """Return whether falls on the records fitted and kept out pay a price of ``least``."""
    return fitted + kept > least and fitted > FITTED * least and kept > KEPT * least
