"""One sentence for the person beside the robot: what it is, on which axes, how much, what to do."""

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
    """The most serious findings first, alike ones together; or that there is nothing, or no name for it."""
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
        return f"Nothing beyond noise on {on_axes(axes, axes)}: nothing to do."
    lost = diagnosis.unexplained
    if diagnosis.verdict is Verdict.UNEXPLAINED or not diagnosis.findings:
        where = f" on {lost.axis}" if lost is not None else ""
        return (
            f"Something{where} is not in the model and no known cause explains it: do not accept it unseen."
        )
    groups = _groups(diagnosis.findings)
    said = [_clause(groups[0], axes, advice=True)]
    same = [g for g in groups[1:] if _grade(g) is _grade(groups[0])]
    rest = [g for g in groups[1:] if _grade(g) is not _grade(groups[0])]
    said += [_lower(_clause(g, axes, advice=False)) for g in same[:1]]
    more = sum(len(g) for g in same[1:])
    if more:
        said.append(f"{more} more alike")
    said += _summed(rest)
    text = "; ".join(said)
    if diagnosis.verdict is Verdict.PARTLY_EXPLAINED:
        text += "; something more is left that has no name"
    return f"{text}."


def _groups(findings: Sequence[Finding]) -> list[list[Finding]]:
    """Findings of one grade and one kind together, in the order of the findings."""
    groups: dict[tuple[Grade, str], list[Finding]] = {}
    for f in findings:
        effect = BY_CAUSE.get(f.effect.cause)
        kind = effect.family if effect is not None and effect.family == "friction" else f.effect.cause
        groups.setdefault((_grade([f]), kind), []).append(f)
    return list(groups.values())


def _grade(group: Sequence[Finding]) -> Grade:
    consequence = group[0].consequence
    return Grade.WATCH if consequence is None else consequence.grade


def _clause(group: Sequence[Finding], axes: Sequence[str], *, advice: bool) -> str:
    """ "Dry friction on all three axes, up to 0.2 % of rated torque: as expected, nothing to do"."""
    if len(group) == 1:
        text = f"{finding_title(group[0])} {_where(group, axes)}"
    else:
        titles = list(dict.fromkeys(cause_title(f.effect.cause) for f in group))
        text = f"{_together(titles)} {_where(group, axes)}{_instead(group, axes)}"
    sizes = [
        f.consequence.text.split(", ")[0] for f in group if f.consequence is not None and f.consequence.text
    ]
    if sizes:
        text += f", {'up to ' if len(group) > 1 else ''}{_largest(group)}"
    grade = _grade(group)
    if grade is Grade.ACT:
        effect = BY_CAUSE.get(group[0].effect.cause)
        todo = "act" if effect is None or not advice else _lower(effect.check.split(";")[0].rstrip("."))
    else:
        todo = _TODO[grade]
    return _upper(f"{text}: {todo}")


def _instead(group: Sequence[Finding], axes: Sequence[str]) -> str:
    """ " (on A2 it may be play instead)", of the findings that the data cannot tell from another cause."""
    contested: dict[str, list[str]] = {}
    for f in group:
        for other in f.alternatives[:1]:
            contested.setdefault(_lower(cause_title(other.cause)), []).append(f.effect.axis)
    said = _and([f"on {on_axes(where, axes)} it may be {other}" for other, where in contested.items()])
    return f" ({said} instead)" if said else ""


def _largest(group: Sequence[Finding]) -> str:
    """The size of the group's largest finding, by its first measure."""

    def size(f: Finding) -> float:
        measures = {} if f.consequence is None else f.consequence.measures
        return abs(next(iter(measures.values()), 0.0))

    largest = max(group, key=size).consequence
    return "" if largest is None else largest.text.split(", ")[0]


def _summed(rest: Sequence[Sequence[Finding]]) -> list[str]:
    """The less serious groups by their number: "2 findings more to watch, 4 as expected"."""
    counts = {
        g: sum(len(group) for group in rest if _grade(group) is g) for g in (Grade.WATCH, Grade.AS_EXPECTED)
    }
    words = {Grade.WATCH: "to watch", Grade.AS_EXPECTED: "as expected"}
    said = [f"{n} {words[g]}" for g, n in counts.items() if n]
    return [f"beside it {' and '.join(said)}"] if said else []


def finding_title(finding: Finding) -> str:
    """What a person calls the cause, with what it may be instead."""
    return " or ".join(
        dict.fromkeys(
            [cause_title(finding.effect.cause), *(cause_title(a.cause) for a in finding.alternatives[:1])]
        )
    )


def cause_title(cause: str) -> str:
    """ "dry friction" of "coulomb_friction"."""
    effect = BY_CAUSE.get(cause)
    return cause.replace("_", " ") if effect is None else effect.title.split(" (")[0]


def _where(group: Sequence[Finding], axes: Sequence[str]) -> str:
    if len(group) > 1:
        return f"on {on_axes([f.effect.axis for f in group], axes)}"
    effect = group[0].effect
    if effect.other_axis is not None:
        return f"of {effect.axis} and {effect.other_axis}"
    place = f" at {effect.element}" if effect.element and effect.element != "mass 1" else ""
    return f"on {effect.axis}{place}"


def on_axes(named: Sequence[str], axes: Sequence[str]) -> str:
    """ "all three axes", "A1 and A2"."""
    some = [a for a in axes if a in named]
    if len(some) == len(axes) and len(axes) > 1:
        count = _COUNTS[len(axes)] if len(axes) < len(_COUNTS) else str(len(axes))
        return "both axes" if len(axes) == 2 else f"all {count} axes"
    return _and(some)


def _together(titles: Sequence[str]) -> str:
    """ "dry and viscous friction" of two titles that end alike."""
    ends = {t.rpartition(" ")[2] for t in titles}
    if len(titles) < 2 or len(ends) != 1 or any(t.count(" ") != 1 for t in titles):
        return _and(titles)
    return f"{_and([t.partition(' ')[0] for t in titles])} {ends.pop()}"


def _and(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""


def _lower(text: str) -> str:
    """First letter small, unless it opens a name as A1."""
    return text if text[1:2].isdigit() or text[:2].isupper() else text[:1].lower() + text[1:]


def _upper(text: str) -> str:
    return text[:1].upper() + text[1:]
