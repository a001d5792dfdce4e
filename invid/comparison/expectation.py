"""Answer a person who said what was changed: the same, more, less, elsewhere, or nothing of the kind."""

from __future__ import annotations

import math
from collections.abc import Sequence

from invid.comparison.changes import Change, Comparison, Status
from invid.effects.registry import BY_CAUSE
from invid.model.expectation import Agreement, Answer, Expectation, Subject
from invid.model.named_change import ChangeKind, NamedChange

ABOUT = 1.5
"""Ratio up to which a size is "about" what was said (a convention): a lever arm guessed to a fifth makes an
inertia by its square."""

_TOOL = (ChangeKind.LOAD, ChangeKind.INERTIA)
_TRANSMISSION = (ChangeKind.SPRING, ChangeKind.DAMPER)
_OPEN = (ChangeKind.ONE_OF, ChangeKind.UNLOCATED, ChangeKind.UNTOLD)
"""Something changed that may be what was said."""


def answer_expectation(said: Expectation, found: Comparison | None) -> Answer:
    """Return the answer to what was said by what the comparison with the accepted model found."""
    if found is None:
        return Answer(said, Agreement.NO_MODEL)
    fitting = [c for c in found.named if _is_of(c, said.subject)]
    here = [c for c in fitting if said.axis in (None, c.axis, c.other_axis)]
    if here:
        change = max(here, key=lambda c: abs(c.share or 0.0))
        return Answer(said, _by_size(said, change), change)
    if fitting:
        return Answer(said, Agreement.ELSEWHERE, fitting[0])
    if any(c.kind in _OPEN for c in found.named) or not found.told:
        return Answer(said, Agreement.CANNOT_TELL)
    return _absent(said, found.parameters)


def _is_of(change: NamedChange, subject: Subject) -> bool:
    effect = BY_CAUSE.get(change.cause or "")
    if subject is Subject.TOOL:
        return change.kind in _TOOL
    if subject is Subject.TRANSMISSION:
        return change.kind in _TRANSMISSION or (change.element or "").startswith("spring")
    return effect is not None and effect.family == "friction"


def _by_size(said: Expectation, change: NamedChange) -> Agreement:
    wanted = said.size if said.size is not None else said.mass
    if wanted is None or change.difference is None:
        return Agreement.AS_SAID
    if wanted * change.difference < 0:
        return Agreement.OPPOSITE
    if said.size is None:
        return Agreement.SIZE_OPEN
    apart = abs(change.difference) - abs(said.size)
    ratio = abs(math.log(abs(change.difference / said.size)))
    if ratio <= math.log(ABOUT) or abs(apart) <= 2.0 * (change.std or 0.0):
        return Agreement.AS_SAID
    return Agreement.MORE if apart > 0 else Agreement.LESS


def _absent(said: Expectation, parameters: Sequence[Change]) -> Answer:
    """Return the answer where nothing of the kind was found: it would have been seen, or not."""
    asked = [p for p in parameters if said.axis in (None, p.axis)]
    if said.subject is Subject.LUBRICATION:  # no number of the linear model stands for it
        return Answer(said, Agreement.NOT_VISIBLE)
    tool = said.subject is Subject.TOOL
    places = [p for p in asked if (p.kind is ChangeKind.LOAD if tool else p.family == "spring")]
    if not places or any(p.bound is None for p in places):
        return Answer(said, Agreement.CANNOT_TELL)
    visible = max((p.bound or 0.0) * p.scale for p in places)
    sure = all(p.status is Status.UNCHANGED for p in places)
    if said.size is not None:
        sure = abs(said.size) > visible
    agreement = Agreement.NOT_VISIBLE if sure else Agreement.CANNOT_TELL
    return Answer(said, agreement, visible=visible if tool else None, unit=places[0].unit)
