"""Causes that are small beside the first: what of them stays at the end of a search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from invid.diagnosis.evidence import attempted, sized
from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import SIGNIFICANCE
from invid.likelihood.joint_fit import fit
from invid.model.place import Place
from invid.numerics import budget
from invid.signals.spectral_record import Record


def without_untold(
    found: Selection, small: set[tuple[str, Place]], train: Sequence[Record], held: Sequence[Record]
) -> Selection:
    """Without the causes of these names whose size is not told from none beside those that came after: they
    took what the law of another left."""
    known, final = len(found.base.fit.candidate.terms), found.final.fit
    lost = [
        n
        for n, s in enumerate(found.steps)
        if (s.chosen.term.effect.cause, s.chosen.term.place) in small
        and sized(final, known + n, SIGNIFICANCE) is False
    ]
    if not lost or len(lost) == len(found.steps) or budget.spent():
        return found
    number = lost[-1]
    kept = [k for k in range(len(final.candidate.terms)) if k != known + number]
    fewer = partial(fit, final.layout, train, final.p, final.candidate.only(kept), iterations=25)
    rest = attempted(fewer, held)
    if rest is None:
        return found
    steps = (*found.steps[:number], *found.steps[number + 1 :])
    return without_untold(replace(found, final=rest, steps=steps), small, train, held)
