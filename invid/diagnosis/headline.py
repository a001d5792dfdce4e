"""The headline for the person beside the robot: what changed, does it matter, where, what now.

``headline_order`` puts parts in order, ``headline`` makes sentences of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from invid.clauses import (
    TOOL_CHANGE,
    answer_clause,
    axes_phrase,
    change_check,
    change_clause,
    change_looks,
    doubt_sentence,
    grade_of,
    group_clause,
)
from invid.effects.registry import BY_CAUSE
from invid.model.diagnosis_document import Diagnosis, Finding, Grade, Verdict
from invid.model.doubts import Doubt, doubts_of
from invid.model.expectation import Agreement, Answer
from invid.model.named_change import ChangeKind, NamedChange, is_tool_change
from invid.wording.figures import explained_percent
from invid.wording.sentence import Figure, clause, joined, listed, marked, sentence, stated

NAMELESS = (Verdict.PARTLY_EXPLAINED, Verdict.UNEXPLAINED)
"""Verdicts on a model that leaves something without a name."""
SIDES = dict.fromkeys(("saturation", "actuator_dynamics"), "loop") | dict.fromkeys(
    ("scale", "sensor", "sampling"), "sensor"
)
"""Families of causes that are not the mechanics."""
_SIDES = {
    "loop": marked("the loop, not the mechanics: {what}"),
    "sensor": marked("a sensor, not the mechanics: {what}"),
    "mechanics": marked("the mechanics: {what}"),
}
MOST = 2
"""Changes told one by one; a person reads no longer headline (a convention)."""


@dataclass(frozen=True)
class Beside:
    """What is known beside a diagnosis: a doubt of how it was measured, and the answer to who said what was
    changed.

    ``screened``: of a short record that was only to tell whether anything changed, the verdict on the
    accepted model.
    """

    doubt: Doubt | None = None
    answer: Answer | None = None
    screened: Verdict | None = None


@dataclass(frozen=True)
class Facts:
    """What a headline is made of.

    ``changes``: against the accepted model; ``None`` where there is none to compare with. ``doubt``: the
    weightiest reason not to trust the result. ``answer``, ``screened``: see ``Beside``.
    """

    axes: Sequence[str]
    linear: bool
    verdict: Verdict
    findings: Sequence[Finding] = ()
    unexplained_axis: str | None = None
    doubt: Doubt | None = None
    changes: Sequence[NamedChange] | None = None
    answer: Answer | None = None
    screened: Verdict | None = None
    is_left_inside: bool = False
    """Whether all that is left acts behind the motors, whose own torque is explained."""
    has_floor: bool = True
    """Whether the record shows what the sensors' noise alone would leave, on every axis."""
    loop: Sequence[Mapping[str, Any]] = ()
    """What the record shows of the loop (``loop_signs``)."""


def facts_of(diagnosis: Diagnosis, beside: Beside = Beside()) -> Facts:
    """Return the facts of a diagnosis; the model's own doubts weigh more than one beside it."""
    own = doubts_of(diagnosis.model.fit)
    return Facts(
        diagnosis.model.axes,
        diagnosis.model.linear,
        diagnosis.verdict,
        diagnosis.findings,
        None if diagnosis.unexplained is None else diagnosis.unexplained.axis,
        own[0] if own else beside.doubt,
        diagnosis.changes,
        beside.answer,
        beside.screened,
        _is_left_inside(diagnosis),
        all(r.noise_floor is not None for r in diagnosis.residual),
        diagnosis.details.get("loop", ()),
    )


def headline(facts: Facts) -> str:
    """Return the headline."""
    return joined([stated(parts) for parts in headline_order(facts) if parts], " ")


def verdict_line(diagnosis: Diagnosis) -> str:
    """Return the verdict with what it is about: how much torque is explained, and where more is left."""
    text = str(diagnosis.verdict)
    if diagnosis.explained_fraction is not None:
        share = explained_percent(diagnosis.explained_fraction)
        text += f", {share} of the torque that the linear model missed is explained"
    if diagnosis.verdict is Verdict.PARTLY_EXPLAINED and _is_left_inside(diagnosis) and diagnosis.forces:
        worst = max(diagnosis.forces, key=lambda f: f.after)
        place = " ".join(p for p in (worst.axis, worst.element, worst.other_axis) if p)
        text += f"; what is left acts behind the motors: {worst.after:.3g} {worst.unit} at {place} in no law"
    return text


def _is_left_inside(diagnosis: Diagnosis) -> bool:
    """Return whether every motor's residual is at its floor (the contract's 1.2): more is left elsewhere."""
    rows = diagnosis.residual
    return bool(rows) and all(r.noise_floor is not None and r.after <= 1.2 * r.noise_floor for r in rows)


def with_headline(diagnosis: Diagnosis, beside: Beside = Beside()) -> Diagnosis:
    """Return the diagnosis with its headline."""
    return replace(diagnosis, headline=headline(facts_of(diagnosis, beside)))


def changes_headline(changes: Sequence[NamedChange]) -> str:
    """Return the headline of changes alone, where nothing is known of the rest."""
    serious = [c for c in changes if c.matters]
    if not changes:
        return sentence("Nothing changed.")
    if not serious:
        return stated(_calm(changes))
    facts = Facts((), False, Verdict.CONSISTENT)
    return joined([stated(_changed(serious)), stated([_now(facts, serious)])], " ")


def headline_order(facts: Facts) -> list[list[str]]:
    """Return the sentences of the headline, each as the statements it joins.

    A doubt comes first only where the change cannot be believed because of it, or where it is of the model
    and nothing changed that matters; else it is the last word, on what to do now. Whoever said what was
    changed is answered before anything else.
    """
    loop = [_loop(facts)] if facts.loop else []
    return [*loop, *_of_machine(facts)]


def _loop(facts: Facts) -> list[str]:
    """That it is the loop and not the mechanics, with the numbers of up to ``MOST`` signs."""
    unit, torque = ("m", "N") if facts.linear else ("rad", "N·m")
    said: list[str] = []
    for row in facts.loop[:MOST]:
        if row["sign"] == "at_limit":
            limit, share = Figure(f"{row['limit']:.3g} {torque}"), Figure(f"{100 * row['share']:.0f} %")
            template = marked("the torque of {axis} stands at its limit of {limit} for {share} of the record")
            said.append(sentence(template, axis=row["axis"], limit=limit, share=share))
        else:
            size, at = (
                Figure(f"{1e3 * row['amplitude']:.2g} m{unit}"),
                Figure(f"{row['frequency_hz']:.3g} Hz"),
            )
            template = marked("{axis} swings by {size} at {frequency} while its goal stands")
            said.append(sentence(template, axis=row["axis"], size=size, frequency=at))
    return [sentence(_SIDES["loop"], what=said[0]), *said[1:]]


def _of_machine(facts: Facts) -> list[list[str]]:
    doubt, changes = facts.doubt, facts.changes
    serious = [c for c in changes or () if c.matters]
    answered = [] if facts.answer is None else [answer_clause(facts.answer)]
    told_already = None if facts.answer is None else facts.answer.change
    if doubt is not None and (doubt.spoils_changes or (doubt.is_of_model and not serious)):
        said = [sentence("this result is not to be trusted: {why}", why=doubt_sentence(doubt))]
        if facts.answer is not None:
            untold = Answer(facts.answer.expectation, Agreement.CANNOT_TELL)
            return [[answer_clause(untold), *said]]
        return [[*said, *([sentence("whether anything changed cannot be told from it")] if changes else [])]]
    if not serious:
        left = None if changes is None else [c for c in changes if c is not told_already]
        calm = [] if told_already is not None and not left else _calm(left)
        return [[*answered, *calm, *_findings(facts, facts.findings)]]
    told = {_place(c) for c in serious if c.cause is not None}
    rest = [f for f in facts.findings if _place_of(f) not in told and grade_of(f) is not Grade.AS_EXPECTED]
    quiet = facts.verdict is Verdict.UNEXPLAINED or facts.screened is not None or not rest
    beside = [] if quiet else _groups(facts, rest)
    return [[*answered, *_changed(serious, told_already)], beside, [_now(facts, serious)]]


def _calm(changes: Sequence[NamedChange] | None) -> list[str]:
    """What is said of changes that do not matter, or of none."""
    if changes is None:
        return []
    if not changes:
        return [sentence("nothing changed since the accepted model")]
    return [change_clause(c) for c in changes[:MOST]]


def _changed(serious: Sequence[NamedChange], told: NamedChange | None = None) -> list[str]:
    """The changes but the one that was told already, what they look like, and how many more there are."""
    tool = is_tool_change(serious)
    # How loads couple and weigh changes with them.
    listed = [c for c in serious if c is not told and (not tool or c.kind is ChangeKind.LOAD)]
    said = []
    for c in listed[:MOST]:
        looks = None if tool else change_looks(c)
        clause = change_clause(c)
        said.append(clause if looks is None else sentence("{what}, {means}", what=clause, means=looks))
    if len(listed) > MOST:
        said.append(sentence("{n} more changes", n=len(listed) - MOST))
    return [*said, TOOL_CHANGE] if tool and told is None else said


def _now(facts: Facts, serious: Sequence[NamedChange]) -> str:
    """What to do now: look at what speaks against it, check, or accept."""
    if facts.screened is not None:
        return sentence("measure in full to take it over")
    if facts.doubt is not None:
        return sentence("accept only for a reason: {why}", why=doubt_sentence(facts.doubt))
    if facts.verdict is Verdict.UNEXPLAINED:
        return _unexplained(facts.unexplained_axis)
    check = next((found for c in serious if (found := change_check(c)) is not None), None)
    return sentence("accept?") if check is None else sentence("before accepting: {what}", what=clause(check))


def _unexplained(axis: str | None) -> str:
    return (
        sentence(
            "something on {axis} is not in the model and no known cause explains it: do not accept it unseen",
            axis=axis,
        )
        if axis
        else sentence("something is not in the model and no known cause explains it: do not accept it unseen")
    )


def _findings(facts: Facts, findings: Sequence[Finding]) -> list[str]:
    """What was found, the most serious first, like ones together."""
    if facts.verdict is Verdict.CONSISTENT:
        said = sentence(
            "nothing beyond noise on {axes}: nothing to do", axes=axes_phrase(facts.axes, facts.axes)
        )
        return [said, *_doubtful_floor(facts)]
    if facts.screened is not None:  # a record of seconds names nothing new by itself
        if facts.screened in NAMELESS:
            return [sentence("as in the accepted model, something is left that has no name")]
        return [
            sentence(
                "something is missing that the accepted model does not have: measure in full to tell what"
            )
        ]
    if facts.verdict is Verdict.UNEXPLAINED or not findings:
        return [_unexplained(facts.unexplained_axis)]
    return _groups(facts, findings)


def _groups(facts: Facts, findings: Sequence[Finding]) -> list[str]:
    groups = _group_findings(findings)
    first = grade_of(groups[0][0])
    same = [g for g in groups[1:] if grade_of(g[0]) is first]
    rest = [g for g in groups[1:] if grade_of(g[0]) is not first]
    said = [group_clause(groups[0], facts.axes, facts.linear)]
    if first is not Grade.AS_EXPECTED and facts.changes is None:
        said = [sentence(_SIDES[_side(groups[0][0])], what=clause(said[0]))]
    said += [group_clause(g, facts.axes, facts.linear, advice=False) for g in same[:1]]
    more = sum(len(g) for g in same[1:])
    if more:
        said.append(sentence("{n} more alike", n=more))
    said += _count_of_rest(rest)
    if facts.verdict is Verdict.PARTLY_EXPLAINED:
        inside = sentence("what is left acts behind the motors and has no name")
        said.append(inside if facts.is_left_inside else sentence("something more is left that has no name"))
    return [*said, *_doubtful_floor(facts)]


def _side(finding: Finding) -> str:
    """Which of loop, sensor and mechanics a finding is of."""
    effect = BY_CAUSE.get(finding.effect.cause)
    return SIDES.get("" if effect is None else effect.family, "mechanics")


def _doubtful_floor(facts: Facts) -> list[str]:
    return (
        []
        if facts.has_floor
        else [sentence("likely, not certain: the recording does not show how much of it is noise")]
    )


def _group_findings(findings: Sequence[Finding]) -> list[list[Finding]]:
    """Findings grouped by grade and kind, in the order of the findings."""
    groups: dict[tuple[Grade, str], list[Finding]] = {}
    for f in findings:
        effect = BY_CAUSE.get(f.effect.cause)
        kind = effect.family if effect is not None and effect.family == "friction" else f.effect.cause
        groups.setdefault((grade_of(f), kind), []).append(f)
    return list(groups.values())


def _count_of_rest(rest: Sequence[Sequence[Finding]]) -> list[str]:
    """The less serious groups as counts, such as "beside it 2 to watch and 4 as expected"."""
    words = {Grade.WATCH: marked("{n} to watch"), Grade.AS_EXPECTED: marked("{n} as expected")}
    counts = {g: sum(len(group) for group in rest if grade_of(group[0]) is g) for g in words}
    said = [sentence(words[g], n=n) for g, n in counts.items() if n]
    return [sentence("beside it {what}", what=listed(said))] if said else []


def _place(change: NamedChange) -> tuple[str | None, ...]:
    return change.cause, change.axis, change.element, change.other_axis


def _place_of(finding: Finding) -> tuple[str | None, ...]:
    effect = finding.effect
    return effect.cause, effect.axis, effect.element, effect.other_axis
