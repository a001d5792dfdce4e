"""What each cause is worth: what goes first of two that stand for each other."""

from functools import partial
from types import SimpleNamespace
from typing import Any

from invid.likelihood.unknown_forces.motor_laws import Part
from invid.likelihood.unknown_forces.worth import Deletion, prune

WITHOUT = {(): 0.0, (Part.RISE,): 5.0, (Part.DRY,): 3.0, (Part.DRY, Part.RISE): 500.0}
"""Rise of −2 ln L without parts of dry friction, of which a rise up to fast speeds is nearly all."""
STRUCTURE = SimpleNamespace(motors=1)


def fitted(*absent: Part) -> Any:
    """As much of a fit as its causes are weighed by."""
    total = WITHOUT[tuple(part for part in (Part.DRY, Part.RISE) if part in absent)]
    found = SimpleNamespace(absent=absent, total=total, kept_total_unmoved=total, motions="stay", strength=())
    found.fit = SimpleNamespace(open_gap=0.0, ended=None)
    found.hypothesis = SimpleNamespace(structure=STRUCTURE)
    found.at_rest_on_kept = lambda: found
    return found


def without(now: Any, part: Part) -> Any:
    return fitted(*now.absent, part)


def deletions(now: Any) -> list[Deletion]:
    there = [part for part in (Part.DRY, Part.RISE) if part not in now.absent]
    return [Deletion(part.value, (part, 0), partial(without, part=part)) for part in there]


def test_a_rise_at_slow_speed_does_not_stand_for_dry_friction() -> None:
    """The least of the two went: of six runs of the case study four had a rise at 0.999 and nothing dry."""
    worths, end = prune(fitted(), deletions)
    assert end.absent == (Part.RISE,)  # type: ignore[attr-defined]
    assert [(w.cause, w.stays) for w in worths] == [("dry", True)]
