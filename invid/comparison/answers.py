"""What a comparison says to who asks: a person who said what was changed, a short record, a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from invid.comparison.changes import Change, Comparison, Status
from invid.diagnosis.headline import NAMELESS, Beside, with_headline
from invid.effects.registry import BY_CAUSE
from invid.errors import ModelError
from invid.identification.stated_inertia import against_stated
from invid.model.diagnosis_document import Diagnosis, Verdict
from invid.model.document import Model
from invid.model.doubts import DoubtCode, doubts_of
from invid.model.expectation import Agreement, Answer, Expectation, Subject
from invid.model.named_change import ChangeKind, NamedChange
from invid.recording.model import Recording

ABOUT = 1.5
"""Ratio up to which a size is "about" what was said (a convention): a lever arm guessed to a fifth makes an
inertia by its square."""

_KINDS = {
    Subject.TOOL: (ChangeKind.LOAD, ChangeKind.INERTIA),
    Subject.TRANSMISSION: (ChangeKind.SPRING, ChangeKind.DAMPER),
    Subject.LUBRICATION: (),
}
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
    of_spring = subject is Subject.TRANSMISSION and (change.element or "").startswith("spring")
    of_friction = subject is Subject.LUBRICATION and effect is not None and effect.family == "friction"
    return change.kind in _KINDS[subject] or of_spring or of_friction


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


# --- a short record ---------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Screening:
    """Answer of one record; ``comparison`` and ``diagnosis`` are ``None`` where the record carries no model.

    ``changed`` names axes ("A2") and pairs of axes ("A1-A2"). The diagnosis names no cause: what a record of
    seconds finds beside the accepted model is for a full one to name.
    """

    verdict: Literal["unchanged", "changed", "cannot tell"]
    changed: tuple[str, ...]
    sentence: str
    comparison: Comparison | None
    diagnosis: Diagnosis | None

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "verdict": self.verdict,
            "changed": list(self.changed),
            "summary": self.sentence,
            "comparison": None if self.comparison is None else self.comparison.to_json(),
        }


def require_screenable(model: Model, axes: tuple[str, ...]) -> None:
    """ModelError where nothing can be tested against a model: of other axes, or without a covariance."""
    if model.axes != axes:
        raise ModelError(
            f"the model has axes {', '.join(model.axes)}, the cell {', '.join(axes)}; give its own model"
        )
    if model.covariance is None:
        raise ModelError(
            "the model has no covariance, so nothing can be tested against it; identify once more with "
            "--method refined and data that show every parameter"
        )


def with_its_causes(model: Model) -> Model:
    """Return the model whose causes a diagnosis takes for granted and fits along.

    A record of seconds does not name again what a long one named; fitted without it, the rest would seem to
    have changed.
    """
    return replace(model, fit={**model.fit, "joint_with_effects": True})


def judge_screening(
    found: Diagnosis, model: Model, compared: Comparison, beside: Beside = Beside()
) -> Screening:
    """Return the answer of a diagnosis that began ``with_its_causes`` of the accepted model.

    ``compared``: the accepted model beside the diagnosis' own.
    """
    known = model.fit.get("verdict")
    # Of a model that was only identified: that nothing was left.
    before = Verdict(known) if known in set(Verdict) else Verdict.EXPLAINED
    found = _beside(found, model)
    told = with_headline(replace(found, changes=compared.named), replace(beside, screened=before))
    named = Verdict.CONSISTENT if found.verdict is Verdict.CONSISTENT else Verdict.UNEXPLAINED
    told = replace(told, findings=(), verdict=named)
    if _is_open(found, compared, before):
        return Screening("cannot tell", (), told.headline, compared, told)
    if not compared.named:
        sentence = f"{told.headline} {_detectable(compared)}".rstrip()
        return Screening("unchanged", (), sentence, compared, told)
    # Of a coupling both axes: neither has it alone.
    places = (f"{c.axis}-{c.other_axis}" if c.other_axis else c.axis for c in compared.named)
    return Screening("changed", tuple(dict.fromkeys(places)), told.headline, compared, told)


def _beside(found: Diagnosis, model: Model) -> Diagnosis:
    """Return the diagnosis with what it finds beside the causes of the accepted model; consistent if nothing.

    Friction of a motor counts as known whatever its law: a record of seconds does not tell laws.
    """
    known = {(_kind(e.cause), e.axis) for e in model.effects}
    new = tuple(f for f in found.findings if (_kind(f.cause), f.axis) not in known)
    quiet = not new and found.verdict is Verdict.EXPLAINED
    return replace(found, findings=new, verdict=Verdict.CONSISTENT if quiet else found.verdict)


def _kind(cause: str) -> str:
    family = BY_CAUSE[cause].family
    return family if family == "friction" else cause


def _is_open(found: Diagnosis, compared: Comparison, before: Verdict) -> bool:
    """Return whether the record leaves open if anything changed: a model not to be trusted, or something that
    the accepted one does not have."""
    spoilt = any(d.spoils_changes for d in doubts_of(found.model.fit))
    new = not compared.named and found.verdict is not Verdict.CONSISTENT and before not in NAMELESS
    return spoilt or new or not compared.told


def _detectable(compared: Comparison) -> str:
    """Return how small a change would have been found, in words."""
    known = [p for p in compared.parameters if p.family != "damper" and p.detectable is not None]
    if not known:
        return ""
    worst = max(known, key=lambda p: p.detectable or 0.0)
    typical = float(np.median([p.detectable or 0.0 for p in known]))
    return (
        f"A change of {100 * typical:.2g} % would have been found in most masses, springs and couplings, of "
        f"{100 * (worst.detectable or 0.0):.2g} % in {worst.label}."
    )


# --- a diagnosis ------------------------------------------------------------------------------------
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
