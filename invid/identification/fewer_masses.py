"""Chains as short as the records show them, of a machine with fewer masses than declared."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from invid.identification.contest import NUMBERS
from invid.likelihood.unknown_forces.correspondence import Correspondence
from invid.likelihood.unknown_forces.descent import LARGEST_STEP
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.price import price
from invid.model.plant import Element, Kind
from invid.numerics import budget
from invid.wording.sentence import sentence

LOOSE = 0.1
"""Deviation of a mass' or spring's logarithm from which on its chain may have a mass too many."""


def expected(found: FittedHypothesis) -> float:
    """−2 ln L after the next step, by its slope and curvature here."""
    around = found.fit.slope
    unit = np.sqrt(np.diag(around.curvature))
    step = np.linalg.solve(around.curvature / unit[:, None] / unit, around.gradient / unit) / unit
    share = min(1.0, LARGEST_STEP / float(np.abs(step).max()))
    return found.total - float(around.gradient @ step) * share * (2.0 - share)


def with_masses_seen(now: FittedHypothesis) -> FittedHypothesis:
    """The fit with each chain as short as costs no more than the price of a mass.

    Only where a mass or spring of a chain is loosely known may one be too many. Of two that are, one alone
    may end where the other holds it: masses go on to go, and the last fit that costs less than they pay is
    taken.
    """
    best, fewer = now, now
    while not budget.is_left_out(sentence("fewer masses than declared")):
        tried = (shortened(fewer, axis) for axis in range(now.hypothesis.structure.motors))
        known = [s for s in tried if s is not None]
        if not known:
            break
        fewer = min(known, key=lambda s: s.total)
        gone = sum(best.hypothesis.structure.sizes) - sum(fewer.hypothesis.structure.sizes)
        if fewer.total - best.total < price(NUMBERS * gone):
            best = fewer
    return best


def shortened(now: FittedHypothesis, axis: int) -> FittedHypothesis | None:
    """The fit with two masses of a chain made one; none where all of them are well known."""
    structure = now.hypothesis.structure
    chain = range(structure.motor[axis], structure.load[axis] + 1)
    links = [structure.links.index((a, a + 1)) for a in chain[:-1]]
    numbers = [structure.index(Kind.MASS).start + a for a in chain]
    numbers += [structure.index(Kind.SPRING).start + k for k in links]
    if not links or np.sqrt(np.diag(now.fit.covariance)[numbers]).max() < LOOSE:
        return None
    pool = []
    for a in chain[:-1]:
        with suppress(np.linalg.LinAlgError):
            pool.append(_merged(now, axis, a))
    best = min(pool, key=expected, default=None)
    return None if best is None else best.refit()


def _merged(now: FittedHypothesis, axis: int, first: int) -> FittedHypothesis:
    """With the masses ``first`` and the next of a chain made one, not fitted."""
    structure, mass = now.hypothesis.structure, now.numbers.plant.of_kind(Kind.MASS)
    at = tuple(i - (i > first) for i in range(structure.coordinates))
    sizes = tuple(n - (i == axis) for i, n in enumerate(structure.sizes))
    fewer = replace(structure, sizes=sizes, modes=tuple(at[h] for h in structure.modes))
    one = {Element(Kind.MASS, first): float(mass[first] + mass[first + 1])}
    return now.in_structure(Correspondence(structure, fewer, at), one, 0)


def fewer_masses_warnings(declared: Sequence[int] | None, found: Sequence[int]) -> list[str]:
    """What is said where fewer masses than declared are seen."""
    if declared is None or tuple(declared) == tuple(found):
        return []
    said, seen = (", ".join(str(n) for n in each) for each in (declared, found))
    return [
        sentence(
            "masses {said} were declared, but {seen} explain the records and no further one is "
            "seen, so these are what the model has: declare them, or excite higher frequencies "
            "to see more",
            said=said,
            seen=seen,
        )
    ]
