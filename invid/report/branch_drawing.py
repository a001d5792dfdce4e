"""Draw the robot as the model sees it: a row of motor, springs with dampers and masses for each axis.

Numbers stand at their element; what changed and each finding is marked there, the findings by their number,
with a shape and a colour for their grade.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader

from invid.clauses import cause_name
from invid.diagnosis.sentences import format_estimate as size_of
from invid.model.diagnosis_document import Finding, Unexplained
from invid.model.document import EffectTerm, Model, linear_parameters, units
from invid.report.branch_marks import (
    BELOW,
    COLOURS,
    INK,
    LEFT,
    MARGIN,
    MASS,
    PAPER,
    SPRING,
    Mark,
    bubbles_of,
    callouts_of,
    place_of,
    places,
    room_of,
    text_width,
)
from invid.report.labels import label, printable
from invid.wording.figures import differing_number
from invid.wording.sentence import ENGLISH, Figure, marked, say, sentence

_WORDS = {
    "title": marked("The drives: motors, springs with dampers, masses"),
    "motor": marked("motor"),
    "load": marked("load"),
    "mass": marked("mass {n}"),
    "spring": marked("spring {n}"),
    "damper": marked("damper"),
    "coupling": marked("coupling {pair}"),
    "single": marked("motor and load"),
    "held": marked("held to ground by {value}"),
    "changed": marked("changed by {change}"),
    "units": marked(
        "Masses in {mass}, springs in {stiffness}, dampers in {damping}; ± one standard deviation."
    ),
    "unexplained": marked("something without a name"),
    "act": marked("act"),
    "watch": marked("watch"),
    "as_expected": marked("as expected"),
    "ungraded": marked("not judged"),
}


def _word(name: str, language: str, **values: object) -> str:
    return say(sentence(_WORDS[name], **values), language)


_QUIET, _CHANGED = "var(--quiet, var(--ink, #1b1c1d))", "var(--before, #c85200)"


def branch_drawing(
    model: Model,
    findings: Sequence[Finding] = (),
    unexplained: Unexplained | None = None,
    *,
    changed: Mapping[str, str] | None = None,
    news: Mapping[int, str] | None = None,
    language: str = ENGLISH,
) -> str:
    """SVG of the branches, with a text alternative inside.

    Parameters
    ----------
    changed
        What changed since an earlier model, by parameter name ("A1.spring.2": "+12 %").
    news
        A word for some of the findings, by their number from 1 ("new").
    language
        Of its words.
    """
    marks = _marks(model, findings, unexplained, news or {}, language)
    elements = elements_of(model, changed or {}, language)
    widest = max((room_of(m.text) for m in marks), default=0.0)
    box, gap = _widths(elements)
    where = places(model, [m.place for m in marks], widest, box=box, gap=gap)
    by_pair = {(e.axis, e.number): e for e in elements if e.kind == "coupling"}
    environment = Environment(loader=PackageLoader("invid.report", ""), autoescape=True)
    environment.filters["g"] = lambda value: f"{value:g}"
    return environment.get_template("branches.svg.j2").render(
        INK=INK, PAPER=PAPER, QUIET=_QUIET, CHANGED=_CHANGED, COLOURS=COLOURS, LEFT=LEFT, BELOW=BELOW,
        title=_word("title", language),
        held=lambda value: _word("held", language, value=value),
        where=where,
        names=[label(a, 6) for a in model.chains.axes],
        elements=elements,
        couplings=[(lane, by_pair[lane.pair]) for lane in where.lanes if lane.pair in by_pair],
        bubbles=bubbles_of(marks, where),
        callouts=callouts_of(marks, where, model.chains),
        legend=textwrap.wrap(_word("units", language, **units(model.linear)), int(where.width / 6.0)),
        told=" ".join(description(elements, marks, model, language)),
    )  # fmt: skip


@dataclass(frozen=True)
class Element:
    """One element with its number: ``kind`` and ``number`` on an axis, of a coupling the other axis."""

    kind: str
    axis: int
    number: int
    value: str
    """With its deviation."""
    unit: str
    change: str | None
    name: str = ""

    @property
    def shown(self) -> str:
        """The number beside its element, with its change."""
        value = self.value.split(" ± ")[0] if self.kind == "coupling" else self.value
        return f"{value} Δ {self.change}" if self.change else value


def elements_of(model: Model, changed: Mapping[str, str], language: str) -> list[Element]:
    """Every element of the drawing, axis by axis from the motor, then couplings."""
    chains, found = model.chains, list[Element]()
    for p in linear_parameters(model):
        axis, *other = (chains.axes.index(a) for a in p.axes)
        names = {
            "mass": mass_name(p.number, chains.masses[axis].size, language),
            "spring": _word("spring", language, n=p.number),
            "damper": _word("damper", language),
            "coupling": _word("coupling", language, pair="–".join(p.axes)),
        }
        if p.value or not other:
            number, value = other[0] if other else p.number, _number(p.value, p.std, language)
            name = names.get(p.kind, "")
            change = changed.get(p.name)
            change = None if change is None else say(change, language)
            found.append(Element(p.kind, axis, number, value, p.unit, change, name))
    return found


def _marks(
    model: Model,
    findings: Sequence[Finding],
    unexplained: Unexplained | None,
    news: Mapping[int, str],
    language: str,
) -> list[Mark]:
    marks = []
    for number, f in enumerate(findings, 1):
        if f.effect.axis not in model.chains.axes:
            continue
        grade = "ungraded" if f.consequence is None else str(f.consequence.grade)
        text = ", ".join(
            filter(
                None,
                [
                    say(cause_name(f.effect.cause), language),
                    _size(f.effect, language),
                    say(news.get(number, ""), language),
                ],
            )
        )
        marks.append(Mark(number, place_of(f.effect, model.chains), grade, text))
    if unexplained is not None and unexplained.axis in model.chains.axes:
        axis = model.chains.axes.index(unexplained.axis)
        marks.append(Mark(0, ("mass", axis, 1), "ungraded", _word("unexplained", language)))
    return marks


def _size(term: EffectTerm, language: str) -> str:
    """The first parameter with a unit, which is the cause's size."""
    for estimate in term.parameters.values():
        if estimate.name is None and math.isfinite(estimate.value):
            return printable(say(size_of(estimate), language), 60)
    return ""


def _number(value: float, std: float, language: str) -> str:
    """ "0.7001 ± 0.0002"; without ± where the data cannot tell, and then said so by "?"."""
    if not (math.isfinite(std) and std > 0):
        return say(Figure(f"{value:.4g} (?)"), language)
    return say(Figure(f"{differing_number(value, std)} ± {differing_number(std, std)}"), language)


def _widths(elements: Sequence[Element]) -> tuple[float, float]:
    """Widths of a mass and of a spring between which every number of the drawing has its room."""
    inside = [max(text_width(e.name, 13.0), text_width(e.value)) for e in elements if e.kind == "mass"]
    between = [
        text_width(e.shown if e.kind == "damper" else e.value)
        for e in elements
        if e.kind in ("spring", "damper")
    ]
    return max(MASS, max(inside) + 2 * MARGIN), max(SPRING, max(between, default=0.0) + MARGIN)


def mass_name(number: int, count: int, language: str = ENGLISH) -> str:
    """ "motor", "mass 2", "load"; of an axis with one mass "motor and load"."""
    name = "single" if count == 1 else "motor" if number == 1 else "load" if number == count else "mass"
    return _word(name, language, n=number)


def description(elements: Sequence[Element], marks: Sequence[Mark], model: Model, language: str) -> list[str]:
    """Return the drawing in sentences, one an axis, one a coupling and one a finding."""

    def told(e: Element) -> str:
        change = f" ({_word('changed', language, change=e.change)})" if e.change else ""
        return f"{e.name}{':' * (e.kind == 'coupling')} {e.value} {e.unit}{change}"

    out = []
    for i, axis in enumerate(model.chains.axes):
        own = [told(e) for e in elements if e.axis == i and e.kind in ("mass", "spring", "damper")]
        out.append(f"{printable(axis, 60)}: {'; '.join(own)}.")
    out += [printable(f"{told(e)}.", 200) for e in elements if e.kind == "coupling"]
    named = {(e.kind, e.axis, e.number): e.name for e in elements}
    for m in marks:
        place = named.get(m.place, "")
        at = place if m.place[0] == "coupling" else f"{model.chains.axes[m.place[1]]} {place}"
        out.append(f"{m.number or '?'}: {printable(at, 140)}, {m.text}: {_word(m.grade, language)}.")
    return out
