"""Inner motion in agreement with the forces that depend on it: a fixed point, mixed so that it is reached.

Plain substitution diverges wherever a force changes by more than the chain resists, which every strong
effect does near a resonance of the inner masses with the motors held. Anderson's mixing (type II) learns
the few directions in which it does from the substitutions themselves.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from invid.arrays import Complex128, Float64
from invid.effects.secants import Secants
from invid.effects.view import View

CLOSE = 1e-4
"""Disagreement, over the largest line of what the forces do, at which there is agreement: the strongest
effects stand 40 dB above the noise on a line, so what is left is a hundredth of it."""
NEGLIGIBLE = 1e-8
"""The same over the largest line of motion: below what 24 bits resolve of a revolution."""
WORSE = 10.0
"""Growth of the disagreement at which the search goes back to the best: far out nothing is linear."""


def settled(
    view: View,
    forces: Callable[[], tuple[Complex128, Complex128]],
    passes: int,
    *,
    early: bool = True,
) -> Complex128:
    """(F, M) contributions at the inner motion that ``forces`` and the plant agree on.

    ``forces()``: contributions and the inner motion (F, dofs) that follows from the view's present one. The
    view is left at the best inner motion seen. ``early``: stop as soon as there is agreement and remember the
    directions; otherwise go all ``passes`` along those known.
    """
    secants = view.secants
    scale = max(float(np.abs(view.base).max()), 1e-300)
    best: tuple[float, Complex128, Complex128, Complex128] | None = None
    before: tuple[Float64, Float64] | None = None
    total: Complex128 = np.zeros_like(view.acting)
    for number in range(passes):
        total, back = forces()
        gap = back - view.feedback
        size = float(np.abs(gap).max())
        enough = max(CLOSE * float(np.abs(back).max()), NEGLIGIBLE * scale)
        if best is None or size < best[0]:
            best = (size, view.feedback, gap, total)
        if (early and size < enough) or number == passes - 1:
            break
        here, rest = _flat(view.feedback), _flat(gap)
        if before is not None and early and np.isfinite(size):
            view.secants = secants = secants.plus(here - before[0], rest - before[1])
        if not np.isfinite(size):
            view.secants = secants = Secants()
        if not size < WORSE * best[0]:  # back, with what was learned on the way
            here, rest = _flat(best[1]), _flat(best[2])
        before = (here, rest)
        view.respond(_shaped(here + secants.step(rest), gap))
    if early and best is not None and best[0] < np.inf:
        view.respond(best[1])
        total = best[3]
    return total


def _flat(values: Complex128) -> Float64:
    return np.ascontiguousarray(values).view(np.float64).ravel()


def _shaped(values: Float64, like: Complex128) -> Complex128:
    out: Complex128 = values.view(np.complex128).reshape(like.shape)
    return out
