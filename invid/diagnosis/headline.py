"""The headline for the person beside the robot: what changed, does it matter, where, what now.

``headline_order`` puts typed statements in order and knows no language; ``headline`` says them in one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from invid.effects.registry import BY_CAUSE
from invid.model.diagnosis_document import Diagnosis, Finding, Grade, Verdict
from invid.model.doubts import Doubt, doubts_of
from invid.model.expectation import Agreement, Answer
from invid.model.named_change import ChangeKind, NamedChange, is_tool_change
from invid.wording.clauses import (
    axes_phrase,
    change_check,
    change_clause,
    change_looks,
    doubt_statement,
    grade_of,
    group_clause,
)
from invid.wording.expectation import answer_clause
from invid.wording.figures import explained_percent
from invid.wording.statement import (
    ENGLISH,
    LANGUAGES,
    Clause,
    Figure,
    Listed,
    Statement,
    Value,
    say,
    say_sentence,
)

NAMELESS = (Verdict.PARTLY_EXPLAINED, Verdict.UNEXPLAINED)
"""Verdicts on a model that leaves something without a name."""
SIDES = dict.fromkeys(("saturation", "actuator_dynamics"), "loop") | dict.fromkeys(
    ("scale", "sensor", "sampling"), "sensor"
)
"""Families of causes that are not the mechanics."""
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


def headline(facts: Facts, language: str = ENGLISH) -> str:
    """Return the headline in a language."""
    return " ".join(say_sentence(parts, language) for parts in headline_order(facts) if parts)


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
    """Return the diagnosis with its headline in every language."""
    said = {language: headline(facts_of(diagnosis, beside), language) for language in LANGUAGES}
    return replace(diagnosis, headline=said[ENGLISH], headlines=said)


def changes_headline(changes: Sequence[NamedChange], language: str = ENGLISH) -> str:
    """Return the headline of changes alone, where nothing is known of the rest."""
    serious = [c for c in changes if c.matters]
    if not changes:
        return say(Statement("told.nothing"), language)
    if not serious:
        return say_sentence(_calm(changes), language)
    facts = Facts((), False, Verdict.CONSISTENT)
    return f"{say_sentence(_changed(serious), language)} {say_sentence([_now(facts, serious)], language)}"


def headline_order(facts: Facts) -> list[list[Statement]]:
    """Return the sentences of the headline, each as the statements it joins.

    A doubt comes first only where the change cannot be believed because of it, or where it is of the model
    and nothing changed that matters; else it is the last word, on what to do now. Whoever said what was
    changed is answered before anything else.
    """
    loop = [_loop(facts)] if facts.loop else []
    return [*loop, *_of_machine(facts)]


def _loop(facts: Facts) -> list[Statement]:
    """That it is the loop and not the mechanics, with the numbers of up to ``MOST`` signs."""
    unit, torque = ("m", "N") if facts.linear else ("rad", "N·m")
    said = []
    for row in facts.loop[:MOST]:
        values: dict[str, Value] = {"axis": row["axis"]}
        if row["sign"] == "at_limit":
            values["limit"] = Figure(f"{row['limit']:.3g} {torque}")
            values["share"] = Figure(f"{100 * row['share']:.0f} %")
        else:
            values["size"] = Figure(f"{1e3 * row['amplitude']:.2g} m{unit}")
            values["frequency"] = Figure(f"{row['frequency_hz']:.3g} Hz")
        said.append(Statement(f"loop.{row['sign']}", values))
    return [Statement("side.loop", {"what": said[0]}), *said[1:]]


def _of_machine(facts: Facts) -> list[list[Statement]]:
    doubt, changes = facts.doubt, facts.changes
    serious = [c for c in changes or () if c.matters]
    answered = [] if facts.answer is None else [answer_clause(facts.answer)]
    told_already = None if facts.answer is None else facts.answer.change
    if doubt is not None and (doubt.spoils_changes or (doubt.is_of_model and not serious)):
        said = [Statement("headline.untrusted", {"why": doubt_statement(doubt)})]
        if facts.answer is not None:
            untold = Answer(facts.answer.expectation, Agreement.CANNOT_TELL)
            return [[answer_clause(untold), *said]]
        return [[*said, *([Statement("headline.unsure")] if changes else [])]]
    if not serious:
        left = None if changes is None else [c for c in changes if c is not told_already]
        calm = [] if told_already is not None and not left else _calm(left)
        return [[*answered, *calm, *_findings(facts, facts.findings)]]
    told = {_place(c) for c in serious if c.cause is not None}
    rest = [f for f in facts.findings if _place_of(f) not in told and grade_of(f) is not Grade.AS_EXPECTED]
    quiet = facts.verdict is Verdict.UNEXPLAINED or facts.screened is not None or not rest
    beside = [] if quiet else _groups(facts, rest)
    return [[*answered, *_changed(serious, told_already)], beside, [_now(facts, serious)]]


def _calm(changes: Sequence[NamedChange] | None) -> list[Statement]:
    """What is said of changes that do not matter, or of none."""
    if changes is None:
        return []
    if not changes:
        return [Statement("change.none")]
    return [change_clause(c) for c in changes[:MOST]]


def _changed(serious: Sequence[NamedChange], told: NamedChange | None = None) -> list[Statement]:
    """The changes but the one that was told already, what they look like, and how many more there are."""
    tool = is_tool_change(serious)
    # How loads couple and weigh changes with them.
    listed = [c for c in serious if c is not told and (not tool or c.kind is ChangeKind.LOAD)]
    said = []
    for c in listed[:MOST]:
        looks = None if tool else change_looks(c)
        clause = change_clause(c)
        said.append(clause if looks is None else Statement("change.means", {"what": clause, "means": looks}))
    if len(listed) > MOST:
        said.append(Statement("change.more", {"n": len(listed) - MOST}))
    return [*said, Statement("looks.tool")] if tool and told is None else said


def _now(facts: Facts, serious: Sequence[NamedChange]) -> Statement:
    """What to do now: look at what speaks against it, check, or accept."""
    if facts.screened is not None:
        return Statement("now.measure")
    if facts.doubt is not None:
        return Statement("now.doubt", {"why": doubt_statement(facts.doubt)})
    if facts.verdict is Verdict.UNEXPLAINED:
        return _unexplained(facts.unexplained_axis)
    check = next((found for c in serious if (found := change_check(c)) is not None), None)
    return Statement("now.accept") if check is None else Statement("now.first", {"what": Clause(check)})


def _unexplained(axis: str | None) -> Statement:
    return Statement("headline.unexplained_on", {"axis": axis}) if axis else Statement("headline.unexplained")


def _findings(facts: Facts, findings: Sequence[Finding]) -> list[Statement]:
    """What was found, the most serious first, like ones together."""
    if facts.verdict is Verdict.CONSISTENT:
        said = Statement("headline.consistent", {"axes": axes_phrase(facts.axes, facts.axes)})
        return [said, *_doubtful_floor(facts)]
    if facts.screened is not None:  # a record of seconds names nothing new by itself
        return [Statement("headline.left_as_before" if facts.screened in NAMELESS else "headline.new")]
    if facts.verdict is Verdict.UNEXPLAINED or not findings:
        return [_unexplained(facts.unexplained_axis)]
    return _groups(facts, findings)


def _groups(facts: Facts, findings: Sequence[Finding]) -> list[Statement]:
    groups = _group_findings(findings)
    first = grade_of(groups[0][0])
    same = [g for g in groups[1:] if grade_of(g[0]) is first]
    rest = [g for g in groups[1:] if grade_of(g[0]) is not first]
    said = [group_clause(groups[0], facts.axes, facts.linear)]
    if first is not Grade.AS_EXPECTED and facts.changes is None:
        said = [Statement(f"side.{_side(groups[0][0])}", {"what": Clause(said[0])})]
    said += [group_clause(g, facts.axes, facts.linear, advice=False) for g in same[:1]]
    more = sum(len(g) for g in same[1:])
    if more:
        said.append(Statement("headline.more_alike", {"n": more}))
    said += _count_of_rest(rest)
    if facts.verdict is Verdict.PARTLY_EXPLAINED:
        said.append(Statement("headline.left_inside" if facts.is_left_inside else "headline.left"))
    return [*said, *_doubtful_floor(facts)]


def _side(finding: Finding) -> str:
    """Which of loop, sensor and mechanics a finding is of."""
    effect = BY_CAUSE.get(finding.effect.cause)
    return SIDES.get("" if effect is None else effect.family, "mechanics")


def _doubtful_floor(facts: Facts) -> list[Statement]:
    return [] if facts.has_floor else [Statement("headline.no_floor")]


def _group_findings(findings: Sequence[Finding]) -> list[list[Finding]]:
    """Findings grouped by grade and kind, in the order of the findings."""
    groups: dict[tuple[Grade, str], list[Finding]] = {}
    for f in findings:
        effect = BY_CAUSE.get(f.effect.cause)
        kind = effect.family if effect is not None and effect.family == "friction" else f.effect.cause
        groups.setdefault((grade_of(f), kind), []).append(f)
    return list(groups.values())


def _count_of_rest(rest: Sequence[Sequence[Finding]]) -> list[Statement]:
    """The less serious groups as counts, such as "beside it 2 to watch and 4 as expected"."""
    counts = {
        g: sum(len(group) for group in rest if grade_of(group[0]) is g)
        for g in (Grade.WATCH, Grade.AS_EXPECTED)
    }
    said = tuple(Statement(f"headline.n_{g}", {"n": n}) for g, n in counts.items() if n)
    return [Statement("headline.beside", {"what": Listed(said)})] if said else []


def _place(change: NamedChange) -> tuple[str | None, ...]:
    return change.cause, change.axis, change.element, change.other_axis


def _place_of(finding: Finding) -> tuple[str | None, ...]:
    effect = finding.effect
    return effect.cause, effect.axis, effect.element, effect.other_axis
