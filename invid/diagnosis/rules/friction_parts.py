"""The friction of a motor, fitted as one law, as the catalogue's laws that are significant in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.diagnosis.thresholds import SIGNIFICANCE
from invid.effects.catalogue.asymmetric_friction import AsymmetricStribeck
from invid.effects.laws.joint import LEAST_SLOW, JointFriction
from invid.effects.laws.sign import DryLaw
from invid.effects.registry import BY_CAUSE
from invid.likelihood.placed_effect import PlacedEffect
from invid.model.place import Place
from invid.numerics.arrays import Float64
from invid.numerics.distributions import chi2_isf

LAW = JointFriction()
PARTS = {"dry": (0,), "viscous": (1,), "slow": (2, 5, 6), "uneven": (3, 4, 5)}
"""Parameters of ``LAW`` that go with a part of it; the first tells it, of what is uneven the first two."""
CONTAINED_IN = {"dry": ("slow", "uneven"), "viscous": ("uneven",)}
"""Parts with which the catalogue's law has another one in any case."""


def friction_parts(x: Float64, covariance: Float64, place: Place) -> list[tuple[PlacedEffect, Float64]]:
    """The catalogue's laws that the friction of a motor at ``place`` consists of, with their parameters.

    ``x`` (8,) and ``covariance`` (8, 8): the parameters of ``LAW`` as they were fitted.
    """
    parts, x = _significant_parts(x, covariance)
    dry, wet, slow, uneven, uneven_wet, uneven_slow = (float(v) for v in x[:6])
    width = float(np.exp(x[7]))
    velocity = max(float(x[6]), float(x[7]) + float(np.log(LEAST_SLOW)))
    if "uneven" in parts:
        law = _dry_law("asymmetric_friction")
        size = [dry + uneven, dry - uneven, wet + uneven_wet, wet - uneven_wet]
        shape: list[float] = []
        if "slow" in parts:
            law = AsymmetricStribeck()
            size, shape = [*size, slow + uneven_slow, slow - uneven_slow], [velocity]
        return [(PlacedEffect(law.rounded(width), place), np.array([*np.maximum(size, 0.0), *shape]))]
    out = []
    if "slow" in parts:
        law = _dry_law("stribeck_friction")
        out.append((PlacedEffect(law.rounded(width), place), np.array([max(dry, 0.0), slow, velocity])))
    elif "dry" in parts:
        out.append((PlacedEffect(_dry_law("coulomb_friction").rounded(width), place), np.array([dry])))
    if "viscous" in parts:
        out.append((PlacedEffect(BY_CAUSE["viscous_friction"], place), np.array([wet])))
    return out


def _significant_parts(x: Float64, covariance: Float64) -> tuple[set[str], Float64]:
    """Names of the parts of ``LAW`` that are significant, and its parameters (8,) without the others.

    The weakest part goes first, and all others are asked anew in the law that stays: beside a rise at slow
    speed hardly any viscous friction can be told (correlation 0.98), beside dry friction alone five times
    less of it.
    """
    seen = np.isfinite(np.diag(covariance))
    scale = np.where(seen, np.sqrt(np.diag(covariance)), 1.0)
    information = np.zeros_like(covariance)
    both = np.ix_(seen, seen)
    information[both] = np.linalg.pinv((covariance / scale / scale[:, None])[both], hermitian=True)
    is_size = np.arange(x.size) < len(LAW.coefficients)
    target = information @ np.where(is_size, x / scale, 0.0)

    def without(dropped: Sequence[str]) -> tuple[Float64, Float64]:
        rows = np.array([not any(k in PARTS[name] for name in dropped) for k in range(x.size)])
        block = np.zeros_like(information)
        block[np.ix_(rows, rows)] = np.linalg.pinv(information[np.ix_(rows, rows)], hermitian=True)
        return block @ target, block

    def ratio(name: str, dropped: Sequence[str]) -> float:
        sizes, block = without([other for other in dropped if other != name])
        rows = list(PARTS[name][: 2 if name == "uneven" else 1])
        if not seen[rows].all() or (name != "uneven" and sizes[rows[0]] <= 0.0):
            return 0.0
        wald = sizes[rows] @ np.linalg.pinv(block[np.ix_(rows, rows)], hermitian=True) @ sizes[rows]
        return float(wald) / chi2_isf(SIGNIFICANCE, len(rows))

    kept, dropped = set(PARTS), list[str]()
    while True:
        asked = [n for n in PARTS if n in kept and kept.isdisjoint(CONTAINED_IN.get(n, ()))]
        weak = min(asked, key=lambda n: ratio(n, dropped), default=None)
        if weak is None or ratio(weak, dropped) > 1.0:
            break
        dropped.append(weak)
        kept.remove(weak)
    back = max(dropped, key=lambda n: ratio(n, dropped), default=None)
    if back is not None and ratio(back, dropped) > 1.0:
        dropped.remove(back)
        kept.add(back)
    return kept, np.where(is_size & seen, scale * without(dropped)[0], x)


def _dry_law(cause: str) -> DryLaw:
    law = BY_CAUSE[cause]
    assert isinstance(law, DryLaw)  # noqa: S101 - the catalogue's friction
    return law
