"""The causes of a fit that a diagnosis weighs."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from invid.diagnosis.unknown_forces.structures import Addition, additions_of, without
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.motions import PlacedLaw
from invid.likelihood.unknown_forces.worth import (
    Deletion,
    channel_deletions,
    friction_deletions,
    spring_deletions,
)


def deletions_of(now: FittedHypothesis) -> list[Deletion]:
    """Every law, spring between loads, part of friction, channel, mode and base."""
    structure = now.hypothesis.structure
    return [
        *(Deletion(p.law.cause, p.key, partial(_without_law, placed=p)) for p in now.hypothesis.laws),
        *spring_deletions(now),
        *friction_deletions(now),
        *channel_deletions(now),
        *(
            Deletion(a.cause, a, partial(_without_addition, own=a), a.numbers(structure))
            for a in additions_of(structure)
        ),
    ]


def _without_law(now: FittedHypothesis, placed: PlacedLaw) -> FittedHypothesis:
    laws = tuple(p for p in now.hypothesis.laws if p.key != placed.key)
    return now.refit(replace(now.hypothesis, laws=laws))


def _without_addition(now: FittedHypothesis, own: Addition) -> FittedHypothesis:
    # A structure that was taken out leaves places whose motion no fit has said.
    return without(now, own).renewed()
