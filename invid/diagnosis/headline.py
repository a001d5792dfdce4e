"""One sentence for the person beside the robot: finding, axes, size, what to do."""

from __future__ import annotations

from collections.abc import Sequence

from invid.effects.registry import BY_CAUSE
from invid.model.diagnosis_document import Diagnosis, Finding, Grade, Verdict

_COUNTS = (
    "no",
    "one",
    "two",
    "three",
    "four",
    "five",
    "six",
    "seven",
    "eight",
    "nine",
    "ten",
    "eleven",
    "twelve",
)
_TODO = {Grade.AS_EXPECTED: "as expected, nothing to do", Grade.WATCH: "compare with the next measurement"}


def headline(diagnosis: Diagnosis) -> str:
    """The most serious findings, like ones together; or that nothing was found, or nothing with a name."""
    axes = diagnosis.model.axes
    if not diagnosis.model.fit.get("trustworthy", True):
        share = diagnosis.details.get("missed_fraction")
        why = (
            f"the model misses {share:.0%} of the torque"
            if share
            else "the search for causes ran out of time"
            if diagnosis.details.get("cut_short") and not diagnosis.findings
            else "the data do not carry the whole model"
        )
        return f"This result is not to be trusted: {why}."
    if diagnosis.verdict is Verdict.CONSISTENT:
        return f"Nothing beyond noise on {axes_text(axes, axes)}: nothing to do."
    unexplained = diagnosis.unexplained
    if diagnosis.verdict is Verdict.UNEXPLAINED or not diagnosis.findings:
        where = f" on {unexplained.axis}" if unexplained is not None else ""
        return (
            f"Something{where} is not in the model and no known cause explains it: do not accept it unseen."
        )
    groups = _group_findings(diagnosis.findings)
    clauses = [_clause(groups[0], axes, advice=True)]
    same = [g for g in groups[1:] if _grade_of(g) is _grade_of(groups[0])]
    rest = [g for g in groups[1:] if _grade_of(g) is not _grade_of(groups[0])]
    clauses += [_lower_first(_clause(g, axes, advice=False)) for g in same[:1]]
    more = sum(len(g) for g in same[1:])
    if more:
        clauses.append(f"{more} more alike")
    clauses += _summary_of_rest(rest)
    text = "; ".join(clauses)
    if diagnosis.verdict is Verdict.PARTLY_EXPLAINED:
        text += "; something more is left that has no name"
    return f"{text}."


def _group_findings(findings: Sequence[Finding]) -> list[list[Finding]]:
    """Findings grouped by grade and kind, in the order of the findings."""
    groups: dict[tuple[Grade, str], list[Finding]] = {}
    for f in findings:
        effect = BY_CAUSE.get(f.effect.cause)
        kind = effect.family if effect is not None and effect.family == "friction" else f.effect.cause
        groups.setdefault((_grade_of([f]), kind), []).append(f)
    return list(groups.values())


def _grade_of(group: Sequence[Finding]) -> Grade:
    consequence = group[0].consequence
    return Grade.WATCH if consequence is None else consequence.grade


def _clause(group: Sequence[Finding], axes: Sequence[str], *, advice: bool) -> str:
    """One clause such as "Dry friction on all three axes, up to 0.2 % of rated torque: as expected, nothing
    to do"."""
    if len(group) == 1:
        text = f"{finding_title(group[0])} {_place_text(group, axes)}"
    else:
        titles = list(dict.fromkeys(cause_title(f.effect.cause) for f in group))
        text = f"{_join_titles(titles)} {_place_text(group, axes)}{_alternatives_clause(group, axes)}"
    sizes = [
        f.consequence.text.split(", ")[0] for f in group if f.consequence is not None and f.consequence.text
    ]
    if sizes:
        text += f", {'up to ' if len(group) > 1 else ''}{_largest_size(group)}"
    grade = _grade_of(group)
    if grade is Grade.ACT:
        effect = BY_CAUSE.get(group[0].effect.cause)
        todo = "act" if effect is None or not advice else _lower_first(effect.check.split(";")[0].rstrip("."))
    else:
        todo = _TODO[grade]
    return _upper_first(f"{text}: {todo}")


def _alternatives_clause(group: Sequence[Finding], axes: Sequence[str]) -> str:
    """A clause such as " (on A2 it may be play instead)" about findings with alternatives."""
    contested: dict[str, list[str]] = {}
    for f in group:
        for other in f.alternatives[:1]:
            contested.setdefault(_lower_first(cause_title(other.cause)), []).append(f.effect.axis)
    said = _join_words(
        [f"on {axes_text(where, axes)} it may be {other}" for other, where in contested.items()]
    )
    return f" ({said} instead)" if said else ""


def _largest_size(group: Sequence[Finding]) -> str:
    """The size of the group's largest finding, by its first measure."""

    def size(f: Finding) -> float:
        measures = {} if f.consequence is None else f.consequence.measures
        return abs(next(iter(measures.values()), 0.0))

    largest = max(group, key=size).consequence
    return "" if largest is None else largest.text.split(", ")[0]


def _summary_of_rest(rest: Sequence[Sequence[Finding]]) -> list[str]:
    """The less serious groups as counts, such as "beside it 2 to watch and 4 as expected"."""
    counts = {
        g: sum(len(group) for group in rest if _grade_of(group) is g)
        for g in (Grade.WATCH, Grade.AS_EXPECTED)
    }
    words = {Grade.WATCH: "to watch", Grade.AS_EXPECTED: "as expected"}
    said = [f"{n} {words[g]}" for g, n in counts.items() if n]
    return [f"beside it {' and '.join(said)}"] if said else []


def finding_title(finding: Finding) -> str:
    """The plain name of the cause, with its first alternative."""
    return " or ".join(
        dict.fromkeys(
            [cause_title(finding.effect.cause), *(cause_title(a.cause) for a in finding.alternatives[:1])]
        )
    )


def cause_title(cause: str) -> str:
    """The plain name of a cause: "dry friction" of "coulomb_friction"."""
    effect = BY_CAUSE.get(cause)
    return cause.replace("_", " ") if effect is None else effect.title.split(" (")[0]


def _place_text(group: Sequence[Finding], axes: Sequence[str]) -> str:
    if len(group) > 1:
        return f"on {axes_text([f.effect.axis for f in group], axes)}"
    effect = group[0].effect
    if effect.other_axis is not None:
        return f"of {effect.axis} and {effect.other_axis}"
    place = f" at {effect.element}" if effect.element and effect.element != "mass 1" else ""
    return f"on {effect.axis}{place}"


def axes_text(named: Sequence[str], axes: Sequence[str]) -> str:
    """The axes in words: "all three axes", "A1 and A2"."""
    some = [a for a in axes if a in named]
    if len(some) == len(axes) and len(axes) > 1:
        count = _COUNTS[len(axes)] if len(axes) < len(_COUNTS) else str(len(axes))
        return "both axes" if len(axes) == 2 else f"all {count} axes"
    return _join_words(some)


def _join_titles(titles: Sequence[str]) -> str:
    """Titles joined, a common last word once: "dry and viscous friction"."""
    ends = {t.rpartition(" ")[2] for t in titles}
    if len(titles) < 2 or len(ends) != 1 or any(t.count(" ") != 1 for t in titles):
        return _join_words(titles)
    return f"{_join_words([t.partition(' ')[0] for t in titles])} {ends.pop()}"


def _join_words(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""


def _lower_first(text: str) -> str:
    """The text with its first letter small, unless it begins with a name such as A1."""
    return text if text[1:2].isdigit() or text[:2].isupper() else text[:1].lower() + text[1:]


def _upper_first(text: str) -> str:
    return text[:1].upper() + text[1:]
