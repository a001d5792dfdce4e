"""Statements about findings and changes: what, where, how large. Their words: ``en.json`` and ``de.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from invid.effects.registry import BY_CAUSE
from invid.effects.sizes import ARCMIN
from invid.model.diagnosis_document import Finding, Grade
from invid.model.document import Estimate
from invid.model.doubts import Doubt
from invid.model.named_change import ChangeKind, NamedChange
from invid.wording.figures import differing_number, signed, signed_share
from invid.wording.statement import Clause, Figure, Listed, Statement, Value, say


def cause_name(cause: str) -> Statement:
    """Return the plain name of a cause: "dry friction" of "coulomb_friction"."""
    effect = BY_CAUSE.get(cause)
    english = cause.replace("_", " ") if effect is None else effect.title.split(" (")[0]
    return Statement(f"cause.{cause}", english=english)


def cause_title(cause: str) -> str:
    """Return the plain name of a cause in English."""
    return say(cause_name(cause))


def cause_check(cause: str) -> Statement | None:
    """Return what to check where a cause is found; ``None`` where nothing is known to."""
    effect = BY_CAUSE.get(cause)
    return Statement(f"check.{cause}", english=effect.check) if effect is not None and effect.check else None


def axes_phrase(named: Sequence[str], axes: Sequence[str]) -> Value:
    """Return the axes in words: "all three axes", "A1 and A2"."""
    some = [a for a in axes if a in named]
    if len(some) == len(axes) and len(axes) > 1:
        count = Statement(f"count.{len(axes)}", english=str(len(axes)))
        return Statement("axes.both") if len(axes) == 2 else Statement("axes.all", {"count": count})
    return Listed(tuple(some))


def place_phrase(what: Value, axis: str, element: str | None, other_axis: str | None) -> Statement:
    """Return "what on A1", with the element where it is not the motor, or "what of A1 and A2"."""
    if other_axis is not None:
        return Statement("headline.of", {"what": what, "axes": Listed((axis, other_axis))})
    if not element or element == "mass 1":
        return Statement("headline.on", {"what": what, "axes": axis})
    return Statement("headline.at", {"what": what, "axes": axis, "element": element_phrase(element)})


def element_phrase(element: str) -> Statement:
    """Return "spring 2" or "mass 3" as a statement."""
    kind, _, number = element.partition(" ")
    return Statement(f"element.{kind}", {"n": number}, english=element) if number else Statement(element)


def size_phrase(finding: Finding, linear: bool) -> Value | None:
    """Return the first measure of a finding ("0.2 % of rated torque"); ``None`` where it has none."""
    consequence = finding.consequence
    if consequence is None or not consequence.text:
        return None
    english = consequence.text.split(", ")[0]
    if not consequence.measures:
        return english
    name, value = next(iter(consequence.measures.items()))
    return Statement(f"measure.{name}", _figures(value, linear), english=english)


def _figures(value: float, linear: bool) -> Mapping[str, Value]:
    """Return a size in every way in which a measure may write it."""
    angle = f"{1e3 * value:.2g} mm" if linear else f"{1e3 * value:.2g} mrad ({value / ARCMIN:.2g}′)"
    return {
        "percent": Figure(f"{100 * value:.2g} %"),
        "signed": Figure(f"{100 * value:+.2g} %".replace("-", "−")),
        "angle": Figure(angle),
        "ms": Figure(f"{1e3 * value:.2g} ms"),
    }


def group_clause(
    group: Sequence[Finding], axes: Sequence[str], linear: bool, *, advice: bool = True
) -> Statement:
    """Return "dry friction on all three axes, up to 0.2 % of rated torque: as expected, nothing to do"."""
    what = _group_name(group, axes)
    sized = [f for f in group if f.consequence is not None and f.consequence.text]
    if sized:
        size = size_phrase(max(group, key=_first_measure), linear) or ""
        if len(group) > 1:
            size = Statement("headline.up_to", {"size": size})
        what = Statement("headline.sized", {"what": what, "size": size})
    grade, check = grade_of(group[0]), cause_check(group[0].effect.cause)
    todo: Value = Statement(f"todo.{grade}")
    if grade is Grade.ACT and advice and group[0].is_doubtful:
        todo = Statement("todo.doubtful", {"experiment": _experiment(group[0])})
    elif grade is Grade.ACT and advice and check is not None:
        todo = Clause(check)
    return Statement("headline.clause", {"what": what, "todo": todo})


def _experiment(finding: Finding) -> Statement:
    """Return what to measure to be sure of a cause."""
    effect = BY_CAUSE.get(finding.effect.cause)
    return Statement(f"experiment.{'hand' if effect is None else effect.separating.kind}")


def _group_name(group: Sequence[Finding], axes: Sequence[str]) -> Value:
    if len(group) == 1:
        effect = group[0].effect
        causes = dict.fromkeys([effect.cause, *(a.cause for a in group[0].alternatives[:1])])
        return place_phrase(
            Listed(tuple(map(cause_name, causes)), "or"), effect.axis, effect.element, effect.other_axis
        )
    places: dict[str, list[str]] = {}
    for f in group:
        places.setdefault(f.effect.cause, []).append(f.effect.axis)
    alike: dict[frozenset[str], list[str]] = {}
    for cause, at in places.items():
        alike.setdefault(frozenset(at), []).append(cause)
    named = Listed(
        tuple(
            Statement(
                "headline.on",
                {"what": Listed(tuple(map(cause_name, causes)), "titles"), "axes": axes_phrase([*at], axes)},
            )
            for at, causes in alike.items()
        )
    )
    contested: dict[str, list[str]] = {}
    for f in group:
        for other in f.alternatives[:1]:
            contested.setdefault(other.cause, []).append(f.effect.axis)
    if not contested:
        return named
    others = Listed(
        tuple(
            Statement("headline.may_be", {"axes": axes_phrase(at, axes), "cause": cause_name(other)})
            for other, at in contested.items()
        )
    )
    return Statement("headline.rivals", {"what": named, "rivals": others})


def _first_measure(finding: Finding) -> float:
    measures = {} if finding.consequence is None else finding.consequence.measures
    return abs(next(iter(measures.values()), 0.0))


def grade_of(finding: Finding) -> Grade:
    """Return the grade of a finding; one without figures is to be watched."""
    return Grade.WATCH if finding.consequence is None else finding.consequence.grade


# --- doubts ---------------------------------------------------------------------------------------
def doubt_statement(doubt: Doubt) -> Statement:
    """Return a doubt in a few words; the sentence of the warnings says more."""
    values: dict[str, Value] = {}
    if "share" in doubt.values:
        values["percent"] = Figure(f"{100 * doubt.values['share']:.0f} %")
    if "times" in doubt.values:
        values["times"] = Figure(f"{doubt.values['times']:.2g}")
    return Statement(f"doubt.{doubt.code}", values)


# --- changes --------------------------------------------------------------------------------------
_LOOKS = {
    ChangeKind.LOAD: "tool",
    ChangeKind.MOTOR_MASS: "motor",
    ChangeKind.MASS: "structure",
    ChangeKind.INERTIA: "structure",
    ChangeKind.DAMPER: "damping",
    ChangeKind.COUPLING: "pose",
    ChangeKind.SCALE: "scale",
}
_DIRECTED = {ChangeKind.SPRING, ChangeKind.DAMPER}


def change_clause(change: NamedChange) -> Statement:
    """Return a change: what, where, by how much."""
    c = change
    code = f"change.{c.kind}"
    if c.kind in _DIRECTED:
        code += ".more" if (c.difference or 0.0) > 0 else ".less"
    values: dict[str, Value] = {
        "axis": c.axis,
        "n": "" if c.number is None else c.number,
        "other": c.other_axis or "",
        "by": Figure(_by(c)),
    }
    if c.cause is not None:
        values["what"] = place_phrase(cause_name(c.cause), c.axis, c.element, c.other_axis)
        values["size"] = Figure(size_text(c.new if c.new is not None else c.old, c.unit))
        values |= {"old": Figure(size_text(c.old, c.unit)), "new": Figure(size_text(c.new, c.unit))}
        values["parameter"] = parameter_name(c.parameter or "")
    if c.kind is ChangeKind.MASSES and c.old is not None and c.new is not None:
        values |= {"before": f"{c.old.value:.0f}", "after": f"{c.new.value:.0f}"}
    if c.kind is ChangeKind.SCALE and c.new is not None:
        values["factor"] = Figure(f"{c.new.value:.4g}")
    if c.kind is ChangeKind.ONE_OF:
        values["what"] = Listed(tuple(label(x, plain=True) for x in c.among), "or")
    said = Statement(code, values)
    return said if c.matters or c.kind is ChangeKind.UNTOLD else Statement("change.small", {"what": said})


def change_looks(change: NamedChange) -> Statement | None:
    """Return what a change looks like; ``None`` where nothing is known, or something is to be checked."""
    looks = _LOOKS.get(change.kind)
    if change.kind is ChangeKind.SPRING and (change.difference or 0.0) > 0:
        looks = "stiffer"
    return None if looks is None else Statement(f"looks.{looks}")


def change_check(change: NamedChange) -> Statement | None:
    """Return what to check after a change; ``None`` where nothing is known to."""
    if change.kind is ChangeKind.SPRING and (change.difference or 0.0) < 0:
        return Statement("check.softer")
    if change.kind in (ChangeKind.APPEARED, ChangeKind.GREW) and change.cause is not None:
        return cause_check(change.cause)
    return None


def row_statement(change: NamedChange) -> Statement:
    """Return a change as a sentence of its own, with what it looks like or what to check."""
    values: dict[str, Value] = {"what": change_clause(change)}
    looks, check = change_looks(change), change_check(change)
    means = looks if check is None else Clause(check)
    if means is None or not change.matters:
        return Statement("told.row", values)
    return Statement("told.row_means", {**values, "means": means})


def _by(change: NamedChange) -> str:
    if change.difference is None or change.std is None:
        return ""
    unit = f" {change.unit}" if change.unit and change.unit != "1" else ""
    share = signed_share(change.share, 1.0) if change.share is not None else ""
    return f"{signed(change.difference, change.std)}{unit}" + (f" ({share})" if share else "")


def label(change: NamedChange, *, plain: bool = False) -> Statement:
    """Return a parameter or cause as a person says it: "A2: final mass", or plain "A2 final mass"."""
    where = f"{change.axis}-{change.other_axis}" if change.kind is ChangeKind.COUPLING else change.axis
    return Statement("label.plain" if plain else "label.of", {"where": where, "element": _element(change)})


def _element(c: NamedChange) -> Statement:
    if c.cause is not None:
        found = Statement("element.cause", {"cause": cause_name(c.cause)})
        if c.other_axis:
            found = Statement("element.cause_to", {"cause": cause_name(c.cause), "other": c.other_axis})
        elif c.element:
            place = element_phrase(c.element)
            found = Statement("element.cause_at", {"cause": cause_name(c.cause), "place": place})
        if c.kind is ChangeKind.EFFECT and c.parameter:
            named = parameter_name(c.parameter)
            return Statement("element.parameter", {"element": found, "parameter": named})
        return found
    if c.kind is ChangeKind.LOAD:
        return Statement("element.only" if c.number == 1 else "element.final")
    kind = "motor" if c.kind is ChangeKind.MOTOR_MASS else str(c.kind)
    return Statement(f"element.{kind}", {"n": "" if c.number is None else c.number})


def parameter_name(parameter: str) -> Statement:
    """Return the name of an effect's parameter."""
    return Statement(f"effect.{parameter}", english=parameter.replace("_", " "))


def size_text(size: Estimate | None, unit: str | None) -> str:
    """Return "2.00 ± 0.05 N·m", small angles and times in thousandths of their unit."""
    if size is None:
        return "0"
    of = f" {unit}" if unit and unit != "1" else ""
    if size.std is None or not size.std > 0:
        return f"{size.value:.4g}{of}"
    if abs(size.value) < 1e-2 and unit in ("rad", "m", "s"):
        return size_text(Estimate(1e3 * size.value, 1e3 * size.std), f"m{unit}")
    return f"{differing_number(size.value, size.std)} ± {differing_number(size.std, size.std)}{of}"
