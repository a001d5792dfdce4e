"""What a comparison has to say first: the changes by weight, and the headline made of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from invid.comparison.causes import CHANGED
from invid.comparison.changes import Comparison
from invid.comparison.named import named_cause, named_change
from invid.comparison.sentences import is_small, is_spread_out, rival_groups, scaled_axes
from invid.diagnosis.headline import with_headline
from invid.identification.stated_inertia import against_stated
from invid.model.diagnosis_document import Diagnosis
from invid.model.document import Estimate, Model
from invid.model.doubts import DoubtCode, doubts_of
from invid.model.named_change import ChangeKind, NamedChange
from invid.recording.model import Recording


def named_changes(c: Comparison, joint_alpha: float) -> tuple[NamedChange, ...]:
    """Return what changed beyond its uncertainty: what matters first, then by kind, then by size.

    Parameters of causes are told with their cause. Where nothing at all can be told, one entry says so.
    """
    if not c.told:
        return (NamedChange(ChangeKind.UNTOLD, matters=False),)
    told = {f"{x.name}.{x.parameter}" for x in c.causes}
    changed = [x for x in c.parameters if x.status == "changed"]
    scaled = scaled_axes(changed, c.parameters)
    grouped = [x for _, own in scaled.values() for x in own]
    found = [*c.shape]
    found += [
        NamedChange(ChangeKind.SCALE, axis, new=Estimate(factor), share=factor - 1.0)
        for axis, (factor, _) in scaled.items()
    ]
    found += [named_change(x, matters=not is_small(x)) for x in changed if x not in grouped]
    found += [
        named_change(x, matters=not is_small(x))
        for x in c.effects
        if x.status == "changed" and x.name not in told
    ]
    found += [named_cause(x) for x in c.causes if x.status in CHANGED]
    separate = [x for x in c.parameters + c.effects if x.rivals]
    found += [
        NamedChange(ChangeKind.ONE_OF, group[0].axis, among=tuple(named_change(x) for x in group))
        for group in rival_groups(separate)
    ]
    if is_spread_out(c, joint_alpha):
        found.append(NamedChange(ChangeKind.UNLOCATED))
    return by_weight(found)


def by_weight(changes: Sequence[NamedChange]) -> tuple[NamedChange, ...]:
    """Return changes as they are told: what matters first, in the order of their kinds, the largest first."""
    order = list(ChangeKind)
    return tuple(sorted(changes, key=lambda c: (not c.matters, order.index(c.kind), -abs(c.share or 0.0))))


def with_changes(diagnosis: Diagnosis, c: Comparison) -> Diagnosis:
    """Return the diagnosis whose headline and grade say what changed since the accepted model first."""
    return with_headline(replace(diagnosis, changes=c.named))


def with_stated_inertia(diagnosis: Diagnosis, recording: Recording, earlier: Model | None) -> Diagnosis:
    """Return the diagnosis that says first where the recording's config states another inertia.

    ``earlier``: an accepted model of the robot, which tells a changed machine from a wrong scale.
    """
    model = against_stated(diagnosis.model, recording, earlier)
    if model is diagnosis.model:
        return diagnosis
    old, new = (
        tuple(d.text for d in doubts_of(m.fit) if d.code is DoubtCode.STATED_INERTIA)
        for m in (diagnosis.model, model)
    )
    kept = tuple(w for w in diagnosis.warnings if w not in old + new)
    return with_headline(replace(diagnosis, model=model, warnings=(*new, *kept)))
