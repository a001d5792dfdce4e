"""Friction with a memory: as it was when an axis stopped it stays until that has moved back by a travel.

Where an axis stands or reverses its velocity says little of its dry friction, and a search leaves such rows
out. Whether friction has a memory shows there alone: it is weighed on every row.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.large_motion.load_dependent_friction import LoadFrictionLaw
from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.price import NUMBER, PARTS, pays, price_at_motors
from invid.numerics import budget
from invid.rigid_motion.fit import Fit, chance_of_gain, falls, fit_terms, settled
from invid.rigid_motion.rows import Rows, colour_of
from invid.rigid_motion.search import BY_WAY, MOST_CHANCE, reshaped, without_idle
from invid.rigid_motion.terms import HELD, PRESLIDING, RISE, Term
from invid.wording.sentence import sentence

YIELDS, LARGEST = 16, 0.1
"""Travels at which an element slides that are looked at, and the largest over the axis's travel: what gives
farther is a spring (empirical)."""


def with_memory(rows: Rows, final: Fit, candidates: Sequence[Term]) -> tuple[Rows, Fit]:
    """Every row and the fit with memory in the dry friction of axes where that pays; else as given.

    Two elements in parallel at most, one that slides at once and one after a travel: generalised Maxwell slip
    (Al-Bender, Lampaert, Swevers, IEEE Transactions on Automatic Control 50(11), 2005).
    """
    if not all(np.isfinite(m.blur).all() for m in rows.motions):
        return rows, final  # of a velocity alone no place is known
    whole = rows.every
    whole.set_colour(colour_of(whole, settled(whole, final.terms).residual))
    current = plain = settled(whole, final.terms)
    found = False
    for axis in range(rows.axes):
        if budget.is_left_out(sentence("friction with a memory")):
            break
        better = _on_axis(whole, current, axis)
        if better is not None:
            current, found = better, True
    if not found:
        return rows, final
    current = without_idle(whole, current, candidates)
    moved = {t.axis for t in {*current.terms} ^ {*final.terms}}
    chances = [chance_of_gain(whole, (plain.held_out, current.held_out), axis) for axis in moved]
    return (whole, current) if max(chances, default=0.0) < MOST_CHANCE else (rows, final)


def _on_axis(rows: Rows, current: Fit, axis: int) -> Fit | None:
    """The fit with memory for what follows the sign of an axis's velocity; ``None`` where it does not pay."""
    dry = [t for t in current.terms if t.axis == axis and t.law in (Part.DRY, RISE, *BY_WAY)]
    loaded = [t for t in current.terms if t.axis == axis and isinstance(t.law, LoadFrictionLaw)]
    rests = [[t for t in current.terms if t not in gone] for gone in (dry, [*dry, *loaded])]
    low = 2.0 * max(float(m.blur[axis]) for m in rows.motions)
    high = LARGEST * max(float(np.ptp(m.position[:, axis])) for m in rows.motions)
    sliders = [Term(PRESLIDING, axis, (float(np.log(y)),)) for y in np.geomspace(low, max(low, high), YIELDS)]
    held = Term(HELD, axis)
    options = [[held], *([s] for s in sliders), *([held, s] for s in sliders)]
    rests = rests if loaded else rests[:1]
    trials = [t for t in (fit_terms(rows, [*r, *o]) for r in rests for o in options) if t.free[-1]]
    if not trials:
        return None
    terms = min(trials, key=lambda t: t.fitted + NUMBER * t.numbers).terms
    best = settled(rows, reshaped(rows, terms, terms[-1], ()) if terms[-1].shape else terms)
    more = best.numbers - current.numbers
    # One law for another brings no number, and has but to be the likelier one.
    least = NUMBER if more <= 0 else price_at_motors(PARTS * len(options), more)
    return best if pays(*falls(current, best), least) else None
