"""Parts of sentences about findings, changes and what a person said: what, where, how large."""

from __future__ import annotations

import math
from collections.abc import Sequence

from invid.effects.registry import BY_CAUSE
from invid.effects.sizes import QUANTITIES
from invid.model.diagnosis_document import Finding, Grade
from invid.model.document import Estimate
from invid.model.doubts import Doubt, DoubtCode
from invid.model.expectation import Agreement, Answer, Expectation
from invid.model.named_change import ChangeKind, NamedChange
from invid.wording.figures import differing_number, signed, signed_share
from invid.wording.sentence import Figure, Sentence, clause, listed, marked, sentence


def cause_name(cause: str) -> str:
    """Return the plain name of a cause: "dry friction" of "coulomb_friction"."""
    effect = BY_CAUSE.get(cause)
    return cause.replace("_", " ") if effect is None else Sentence(effect.title.split(" (")[0])


def cause_check(cause: str) -> str | None:
    """Return what to check where a cause is found; ``None`` where nothing is known to."""
    effect = BY_CAUSE.get(cause)
    return Sentence(effect.check) if effect is not None and effect.check else None


def causes_phrase(causes: Sequence[str]) -> str:
    """Return names of causes as a list; the two common kinds of friction share their last word."""
    match causes:
        case ["coulomb_friction", "viscous_friction"]:
            return sentence("dry and viscous friction")
        case ["viscous_friction", "coulomb_friction"]:
            return sentence("viscous and dry friction")
    return listed([cause_name(c) for c in causes])


_COUNTS = [
    sentence("three"), sentence("four"), sentence("five"), sentence("six"), sentence("seven"),
    sentence("eight"), sentence("nine"), sentence("ten"), sentence("eleven"), sentence("twelve"),
]  # fmt: skip


def axes_phrase(named: Sequence[str], axes: Sequence[str]) -> str:
    """Return the axes in words: "all three axes", "A1 and A2"."""
    some, n = [a for a in axes if a in named], len(axes)
    if len(some) < n or n < 2:
        return listed(some)
    if n == 2:
        return sentence("both axes")
    return sentence("all {count} axes", count=_COUNTS[n - 3] if n - 3 < len(_COUNTS) else n)


def place_phrase(what: str, axis: str, element: str | None, other_axis: str | None) -> str:
    """Return "what on A1", with the element where it is not the motor, or "what of A1 and A2"."""
    if other_axis is not None:
        return sentence("{what} of {axes}", what=what, axes=listed([axis, other_axis]))
    if not element or element == "mass 1":
        return sentence("{what} on {axes}", what=what, axes=axis)
    return sentence("{what} on {axes} at {element}", what=what, axes=axis, element=element_phrase(element))


_ELEMENTS = {
    "only": marked("mass"),
    "motor": marked("motor mass"),
    "mass": marked("mass {n}"),
    "final": marked("final mass"),
    "spring": marked("spring {n}"),
    "damper": marked("damper {n}"),
    "ground_spring": marked("spring to ground"),
    "coupling": marked("coupling"),
    "inertia": marked("whole inertia"),
}


def element_phrase(element: str) -> str:
    """Return "spring 2" or "mass 3" of the name of an element."""
    kind, _, number = element.partition(" ")
    return sentence(_ELEMENTS[kind], n=number) if number and kind in _ELEMENTS else element


def size_phrase(finding: Finding, linear: bool) -> str:
    """Return the first measure of a finding ("0.2 % of rated torque"); empty where it has none."""
    consequence = finding.consequence
    if consequence is None or not consequence.text:
        return ""
    name, value = next(iter(consequence.measures.items()), ("", 0.0))
    return QUANTITIES[name].phrase(value, linear) if name in QUANTITIES else consequence.text.split(", ")[0]


_DEPENDENT = {
    "position": sentence("position-dependent"),
    "velocity": sentence("velocity-dependent"),
    "amplitude": sentence("amplitude-dependent"),
    "time": sentence("time-dependent"),
}


def dependent_on(quantity: str) -> str:
    """Return "velocity-dependent" of a quantity, as the contract has it."""
    return _DEPENDENT.get(quantity, f"{quantity}-dependent")


_TODO = {
    Grade.AS_EXPECTED: sentence("as expected, nothing to do"),
    Grade.WATCH: sentence("compare with the next measurement"),
    Grade.ACT: sentence("act"),
}
_EXPERIMENTS = {
    "speeds": sentence("measure slow moves in both directions at several speeds"),
    "positions": sentence("measure a slow move over a whole revolution"),
    "amplitudes": sentence("measure again at another amplitude"),
    "band": sentence("measure again with a wider band"),
    "lines": sentence("measure again with more and wider frequencies"),
    "time": sentence("measure again, the first experiment once more at the end"),
    "hand": sentence("confirm the cause by hand"),
}


def group_clause(group: Sequence[Finding], axes: Sequence[str], linear: bool, *, advice: bool = True) -> str:
    """Return "dry friction on all three axes, up to 0.2 % of rated torque: as expected, nothing to do"."""
    what = _group_name(group, axes)
    sized = [f for f in group if f.consequence is not None and f.consequence.text]
    if sized:
        size = size_phrase(max(group, key=_first_measure), linear)
        if len(group) > 1:
            size = sentence("up to {size}", size=size)
        what = sentence("{what}, {size}", what=what, size=size)
    grade, check = grade_of(group[0]), cause_check(group[0].effect.cause)
    todo: str = _TODO[grade]
    if grade is Grade.ACT and advice and group[0].is_doubtful:
        todo = sentence(
            "not sure yet: {experiment} before anything is repaired", experiment=_experiment(group[0])
        )
    elif grade is Grade.ACT and advice and check is not None:
        todo = clause(check)
    return sentence("{what}: {todo}", what=what, todo=todo)


def _experiment(finding: Finding) -> str:
    """Return what to measure to be sure of a cause."""
    effect = BY_CAUSE.get(finding.effect.cause)
    return _EXPERIMENTS["hand" if effect is None else str(effect.separating.kind)]


def _group_name(group: Sequence[Finding], axes: Sequence[str]) -> str:
    if len(group) == 1:
        effect = group[0].effect
        causes = dict.fromkeys([effect.cause, *(a.cause for a in group[0].alternatives[:1])])
        what = listed([cause_name(c) for c in causes], alternatives=True)
        return place_phrase(what, effect.axis, effect.element, effect.other_axis)
    places: dict[str, list[str]] = {}
    for f in group:
        places.setdefault(f.effect.cause, []).append(f.effect.axis)
    alike: dict[frozenset[str], list[str]] = {}
    for cause, at in places.items():
        alike.setdefault(frozenset(at), []).append(cause)
    named = listed(
        [
            sentence("{what} on {axes}", what=causes_phrase(causes), axes=axes_phrase([*at], axes))
            for at, causes in alike.items()
        ]
    )
    contested: dict[str, list[str]] = {}
    for f in group:
        for other in f.alternatives[:1]:
            contested.setdefault(other.cause, []).append(f.effect.axis)
    if not contested:
        return named
    others = [
        sentence("on {axes} it may be {cause}", axes=axes_phrase(at, axes), cause=cause_name(other))
        for other, at in contested.items()
    ]
    return sentence("{what} ({rivals} instead)", what=named, rivals=listed(others))


def _first_measure(finding: Finding) -> float:
    measures = {} if finding.consequence is None else finding.consequence.measures
    return abs(next(iter(measures.values()), 0.0))


def grade_of(finding: Finding) -> Grade:
    """Return the grade of a finding; one without figures is to be watched."""
    return Grade.WATCH if finding.consequence is None else finding.consequence.grade


# --- doubts ---------------------------------------------------------------------------------------
_DOUBTS = {
    DoubtCode.MISSED_TORQUE: marked("the model misses {percent} of the torque"),
    DoubtCode.STATED_INERTIA: marked(
        "an inertia is {times} times the one in the config: a torque scale is wrong, or the "
        "machine has changed"
    ),
    DoubtCode.LITTLE_EXPLAINED: marked("the model explains only {percent} of the torque"),
    DoubtCode.TORQUE_BEHIND_SPRING: marked(
        "the torque is measured behind the spring, or the motor is far lighter than its load"
    ),
    DoubtCode.WRONG_STRUCTURE: marked("a model of another structure would fit {times} times better"),
    DoubtCode.SHORT_RECORD: marked("the recording ends before one period of its excitation"),
    DoubtCode.ORDER_OPEN: marked("the data do not tell how many masses there are"),
    DoubtCode.CUT_SHORT: marked("the search for causes ran out of time"),
    DoubtCode.UNSEEN: marked("the data do not carry the whole model"),
    DoubtCode.OTHER: marked("the data do not carry the model"),
    DoubtCode.UNEXPLAINED: marked(
        "the model misses torque on the measured data, and no known cause explains it"
    ),
    DoubtCode.TEST: marked(
        "it was measured with a test's small torques: friction and noise weigh more than in a full run"
    ),
}


def doubt_sentence(doubt: Doubt) -> str:
    """Return a doubt in a few words; the sentence of the warnings says more."""
    share, times = doubt.values.get("share", 0.0), doubt.values.get("times", 0.0)
    return sentence(_DOUBTS[doubt.code], percent=Figure(f"{100 * share:.0f} %"), times=Figure(f"{times:.2g}"))


# --- changes --------------------------------------------------------------------------------------
_CHANGES: dict[str, str] = {
    ChangeKind.LOAD: marked("new load on {axis}: {by}"),
    ChangeKind.MOTOR_MASS: marked("new mass at the motor of {axis}: {by}"),
    ChangeKind.MASS: marked("mass {n} of {axis} changed: {by}"),
    ChangeKind.INERTIA: marked("the whole inertia of {axis} changed: {by}"),
    "spring.more": marked("spring {n} of {axis} is stiffer: {by}"),
    "spring.less": marked("spring {n} of {axis} is softer: {by}"),
    ChangeKind.GROUND_SPRING: marked("the spring to ground of {axis} changed: {by}"),
    "damper.more": marked("more damping in spring {n} of {axis}: {by}"),
    "damper.less": marked("less damping in spring {n} of {axis}: {by}"),
    ChangeKind.COUPLING: marked("the inertia coupling of {axis} and {other} changed: {by}"),
    ChangeKind.SCALE: marked("all masses and springs of {axis} changed by the same factor {factor}"),
    ChangeKind.EFFECT: marked("{what} changed in its {parameter}: {by}"),
    ChangeKind.APPEARED: marked("new: {what}, {size}"),
    ChangeKind.GREW: marked("{what} grew: {old} → {new}"),
    ChangeKind.SHRANK: marked("{what} shrank: {old} → {new}"),
    ChangeKind.GONE: marked("{what} is gone, it was {old}"),
    ChangeKind.MASSES: marked("{axis} had {before} and now has {after} masses"),
    ChangeKind.AXIS_NEW: marked("{axis} is new"),
    ChangeKind.AXIS_GONE: marked("{axis} is no longer there"),
    ChangeKind.ONE_OF: marked("{what} changed, the data do not tell which"),
    ChangeKind.UNLOCATED: marked("something changed, the data do not tell what: measure longer"),
    ChangeKind.UNTOLD: marked("what changed cannot be told: no number is known well enough in both models"),
}
TOOL_CHANGE = sentence("looks like a tool change")
_STRUCTURE = sentence("looks like another load or structure between motor and tool")
_LOOKS = {
    ChangeKind.LOAD: TOOL_CHANGE,
    ChangeKind.MOTOR_MASS: sentence("looks like another motor, brake or coupling"),
    ChangeKind.MASS: _STRUCTURE,
    ChangeKind.INERTIA: _STRUCTURE,
    ChangeKind.DAMPER: sentence("looks like lubrication or temperature"),
    ChangeKind.COUPLING: sentence("looks like another load or pose"),
    ChangeKind.SCALE: sentence("looks like another torque scale of the drive"),
}
_DIRECTED = {ChangeKind.SPRING, ChangeKind.DAMPER}


def change_clause(change: NamedChange) -> str:
    """Return a change: what, where, by how much."""
    c = change
    code = f"{c.kind}.{'more' if (c.difference or 0.0) > 0 else 'less'}" if c.kind in _DIRECTED else c.kind
    values: dict[str, object] = {
        "axis": c.axis, "n": "" if c.number is None else c.number, "other": c.other_axis or "", "by": _by(c),
    }  # fmt: skip
    if c.cause is not None:
        values["what"] = place_phrase(cause_name(c.cause), c.axis, c.element, c.other_axis)
        values["size"] = size_text(c.new if c.new is not None else c.old, c.unit)
        values |= {"old": size_text(c.old, c.unit), "new": size_text(c.new, c.unit)}
        values["parameter"] = parameter_name(c.parameter or "")
    if c.kind is ChangeKind.MASSES and c.old is not None and c.new is not None:
        values |= {"before": f"{c.old.value:.0f}", "after": f"{c.new.value:.0f}"}
    if c.kind is ChangeKind.SCALE and c.new is not None:
        values["factor"] = Figure(f"{c.new.value:.4g}")
    if c.kind is ChangeKind.ONE_OF:
        values["what"] = listed([label(x, plain=True) for x in c.among], alternatives=True)
    said = sentence(_CHANGES[code], **values)
    return (
        said
        if c.matters or c.kind is ChangeKind.UNTOLD
        else sentence("{what}, too small to matter", what=said)
    )


def change_looks(change: NamedChange) -> str | None:
    """Return what a change looks like; ``None`` where nothing is known, or something is to be checked."""
    if change.kind is ChangeKind.SPRING and (change.difference or 0.0) > 0:
        return sentence("looks like a tightened belt or an exchanged gear")
    return _LOOKS.get(change.kind)


def change_check(change: NamedChange) -> str | None:
    """Return what to check after a change; ``None`` where nothing is known to."""
    if change.kind is ChangeKind.SPRING and (change.difference or 0.0) < 0:
        return sentence("check belt tension, screws and the gear for wear")
    if change.kind in (ChangeKind.APPEARED, ChangeKind.GREW) and change.cause is not None:
        return cause_check(change.cause)
    return None


def row_sentence(change: NamedChange) -> str:
    """Return a change as a sentence of its own, with what it looks like or what to check."""
    what, looks, check = change_clause(change), change_looks(change), change_check(change)
    means = looks if check is None else clause(check)
    if means is None or not change.matters:
        return sentence("{what}.", what=what)
    return sentence("{what}; {means}.", what=what, means=means)


def _by(change: NamedChange) -> str:
    if change.difference is None or change.std is None:
        return ""
    unit = f" {change.unit}" if change.unit and change.unit != "1" else ""
    share = signed_share(change.share, 1.0) if change.share is not None else ""
    return Figure(f"{signed(change.difference, change.std)}{unit}" + (f" ({share})" if share else ""))


def label(change: NamedChange, *, plain: bool = False) -> str:
    """Return a parameter or cause as a person says it: "A2: final mass", or plain "A2 final mass"."""
    where = f"{change.axis}-{change.other_axis}" if change.kind is ChangeKind.COUPLING else change.axis
    if plain:
        return sentence("{where} {element}", where=where, element=_element(change))
    return sentence("{where}: {element}", where=where, element=_element(change))


def _element(c: NamedChange) -> str:
    if c.cause is not None:
        found = cause_name(c.cause)
        if c.other_axis:
            found = sentence("{cause} to {other}", cause=found, other=c.other_axis)
        elif c.element:
            found = sentence("{cause} at {place}", cause=found, place=element_phrase(c.element))
        if c.kind is ChangeKind.EFFECT and c.parameter:
            return sentence("{element}, {parameter}", element=found, parameter=parameter_name(c.parameter))
        return found
    kind = str(c.kind)
    if c.kind is ChangeKind.LOAD:
        kind = "only" if c.number == 1 else "final"
    elif c.kind is ChangeKind.MOTOR_MASS:
        kind = "motor"
    return sentence(_ELEMENTS[kind], n="" if c.number is None else c.number)


_PARAMETERS = {
    "torque": sentence("torque"),
    "coefficient": sentence("coefficient"),
    "static": sentence("sticking torque"),
    "coulomb": sentence("sliding torque"),
    "velocity": sentence("velocity"),
    "stiffness": sentence("stiffness"),
    "coulomb_positive": sentence("dry, forwards"),
    "coulomb_negative": sentence("dry, backwards"),
    "viscous_positive": sentence("viscous, forwards"),
    "viscous_negative": sentence("viscous, backwards"),
    "cycles_per_rev": sentence("cycles per turn"),
    "phase": sentence("phase"),
    "delay": sentence("delay"),
    "time_constant": sentence("time constant"),
    "gain": sentence("gain"),
    "limit": sentence("limit"),
    "amplitude": sentence("amplitude"),
    "fraction": sentence("share"),
    "gap": sentence("free play"),
    "angle": sentence("angle"),
    "mass": sentence("mass"),
    "time": sentence("time"),
    "parameter": sentence("parameter"),
    "rate": sentence("rate"),
    "damping_ratio": sentence("damping ratio"),
    "share_1": sentence("moves with the base, axis 1"),
    "share_2": sentence("moves with the base, axis 2"),
    "share_3": sentence("moves with the base, axis 3"),
    "share_4": sentence("moves with the base, axis 4"),
    "share_5": sentence("moves with the base, axis 5"),
    "share_6": sentence("moves with the base, axis 6"),
    "inertia_counts": sentence("inertia counts"),
}


def parameter_name(parameter: str) -> str:
    """Return the name of an effect's parameter."""
    return _PARAMETERS.get(parameter, parameter.replace("_", " "))


def size_text(size: Estimate | None, unit: str | None) -> str:
    """Return "2.00 ± 0.05 N·m", small angles and times in thousandths of their unit."""
    if size is None:
        return "0"
    of = f" {unit}" if unit and unit != "1" else ""
    if size.std is None or not size.std > 0:
        return Figure(f"{size.value:.4g}{of}")
    if abs(size.value) < 1e-2 and unit in ("rad", "m", "s"):
        return size_text(Estimate(1e3 * size.value, 1e3 * size.std), f"m{unit}")
    return Figure(f"{differing_number(size.value, size.std)} ± {differing_number(size.std, size.std)}{of}")


# --- what a person said was changed ---------------------------------------------------------------
_ANSWERS = {
    Agreement.AS_SAID: marked("as you said, {found}"),
    Agreement.SIZE_OPEN: marked("as you said, {found}: what {mass} makes at {arm} from the axis"),
    Agreement.MORE: marked("more than you said ({said}), {found}"),
    Agreement.LESS: marked("less than you said ({said}), {found}"),
    Agreement.OPPOSITE: marked("the other way round than you said ({said}), {found}"),
    Agreement.ELSEWHERE: marked("elsewhere than you said ({said}), {found}"),
    Agreement.NOT_VISIBLE: marked("what you said ({said}) is not visible"),
    Agreement.CANNOT_TELL: marked("whether it is as you said ({said}) cannot be told"),
    Agreement.NO_MODEL: marked(
        "whether it is as you said ({said}) cannot be told, as there is no accepted model yet"
    ),
}


def answer_clause(answer: Answer) -> str:
    """Return whether the change found is what was said: "as you said, new load on A2: …"."""
    said, change = said_phrase(answer.expectation), answer.change
    if change is None and answer.visible is not None and answer.agreement is Agreement.NOT_VISIBLE:
        visible = Figure(f"±{answer.visible:.2g} {answer.unit or ''}".rstrip())
        return sentence(
            "what you said ({said}) is not visible, and beyond {visible} it would be",
            said=said,
            visible=visible,
        )
    values: dict[str, object] = {"said": said, "found": "" if change is None else change_clause(change)}
    mass, found = answer.expectation.mass, None if change is None else change.difference
    if answer.agreement is Agreement.SIZE_OPEN and mass and found is not None:
        values["mass"] = Figure(f"{abs(mass):.3g} kg")
        # The distance from the axis at which the mass that was said makes what was found.
        values["arm"] = Figure(f"{math.sqrt(found / mass):.2g} m")
    return sentence(_ANSWERS[answer.agreement], **values)


_SUBJECTS = {
    "tool": sentence("another tool"),
    "transmission": sentence("gear or belt changed"),
    "lubrication": sentence("other lubrication"),
}


def said_phrase(said: Expectation) -> str:
    """Return what was said in a few words: "another tool on A2, about +1.3 kg·m²"."""
    subject = _SUBJECTS[str(said.subject)]
    where = subject if said.axis is None else sentence("{what} on {axis}", what=subject, axis=said.axis)
    amount = said.size if said.size is not None else said.mass
    if amount is None:
        return where
    unit = "kg" if said.size is None or said.linear else "kg·m²"
    size = Figure(f"{amount:+.3g} {unit}".replace("-", "−"))
    return sentence("{what}, about {size}", what=where, size=size)
