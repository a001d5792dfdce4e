"""Draw the robot as the model sees it: a row of motor, springs with dampers and masses for each axis.

Numbers stand at their element; what changed and each finding is marked there, the findings by their number,
with a shape and a colour for their grade.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

from invid.diagnosis.sentences import format_estimate as size_of
from invid.model.diagnosis_document import Finding, Unexplained
from invid.model.document import EffectTerm, Model, units
from invid.report.branch_marks import (
    BELOW,
    INK,
    LEFT,
    LINE,
    MARGIN,
    MASS,
    PAPER,
    SPRING,
    Mark,
    Places,
    callout,
    changed_places,
    lines_below,
    marked,
    place_of,
    places,
    room_of,
    text_at,
    text_width,
)
from invid.report.labels import label, printable
from invid.wording.clauses import cause_title
from invid.wording.figures import differing_number

WORDS: Mapping[str, str] = {
    "title": "The drives: motors, springs with dampers, masses",
    "motor": "motor",
    "load": "load",
    "mass": "mass {n}",
    "spring": "spring {n}",
    "damper": "damper",
    "coupling": "coupling {pair}",
    "single": "motor and load",
    "held": "held to ground by {value}",
    "changed": "changed by {change}",
    "units": "Masses in {mass}, springs in {stiffness}, dampers in {damping}; ± one standard deviation.",
    "unexplained": "something without a name",
    "act": "act",
    "watch": "watch",
    "as_expected": "as expected",
    "ungraded": "not judged",
    "point": ".",
}
"""Words of the drawing; ``cause.<name>`` may be among them, else the catalogue's title stands."""

_QUIET, _CHANGED = "var(--quiet, var(--ink, #1b1c1d))", "var(--before, #c85200)"


def branch_drawing(
    model: Model,
    findings: Sequence[Finding] = (),
    unexplained: Unexplained | None = None,
    *,
    changed: Mapping[str, str] | None = None,
    news: Mapping[int, str] | None = None,
    words: Mapping[str, str] | None = None,
) -> str:
    """SVG of the branches, with a text alternative inside.

    Parameters
    ----------
    changed
        What changed since an earlier model, by parameter name ("A1.spring.2": "+12 %").
    news
        A word for some of the findings, by their number from 1 ("new").
    words
        Another language's ``WORDS``; what is missing there is English.
    """
    said = {**WORDS, **(words or {})}
    marks = _marks(model, findings, unexplained, news or {}, said)
    changes = changed_places(changed or {}, model.chains)
    widest = max((room_of(m.text) for m in marks), default=0.0)
    box, gap = _widths(model, changes, said)
    where = places(model, [m.place for m in marks], widest, box=box, gap=gap)
    parts = [_couplings(model, where, changes, said)]
    parts += [_row(model, i, where, changes, said) for i in range(model.chains.branches)]
    parts += [
        marked(where, [m for m in marks if m.place == p]) for p in dict.fromkeys(m.place for m in marks)
    ]
    for i in range(model.chains.branches):
        for k, m in enumerate([m for m in marks if m.place[1] == i]):
            line = k + lines_below(model.chains, i)
            parts.append(callout(m, where, where.rows[i] + BELOW + 6 + line * LINE))
    legend, height = _legend(model, where, said)
    parts.append(legend)
    told = " ".join(description(model, marks, changes, said))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {where.width:g} {height:g}" role="img" '
        f'aria-labelledby="branches-title branches-desc" font-family="system-ui, sans-serif" font-size="13" '
        f'fill="{INK}"><title id="branches-title">{escape(said["title"])}</title>'
        f'<desc id="branches-desc">{escape(told)}</desc>{"".join(parts)}</svg>'
    )


def _marks(
    model: Model,
    findings: Sequence[Finding],
    unexplained: Unexplained | None,
    news: Mapping[int, str],
    said: Mapping[str, str],
) -> list[Mark]:
    marks = []
    for number, f in enumerate(findings, 1):
        if f.effect.axis not in model.chains.axes:
            continue
        grade = "ungraded" if f.consequence is None else str(f.consequence.grade)
        text = ", ".join(filter(None, [_named(f.effect, said), _size(f.effect, said), news.get(number, "")]))
        marks.append(Mark(number, place_of(f.effect, model.chains), grade, text))
    if unexplained is not None and unexplained.axis in model.chains.axes:
        axis = model.chains.axes.index(unexplained.axis)
        marks.append(Mark(0, ("mass", axis, 1), "ungraded", said["unexplained"]))
    return marks


def _named(term: EffectTerm, said: Mapping[str, str]) -> str:
    return said.get(f"cause.{term.cause}") or cause_title(term.cause)


def _size(term: EffectTerm, said: Mapping[str, str]) -> str:
    """The first parameter with a unit, which is the cause's size."""
    for estimate in term.parameters.values():
        if estimate.name is None and math.isfinite(estimate.value):
            return printable(_local(size_of(estimate), said), 60)
    return ""


def _local(text: str, said: Mapping[str, str]) -> str:
    return text.replace(".", said["point"])


def _number(value: float, std: float, said: Mapping[str, str]) -> str:
    """ "0.7001 ± 0.0002"; without ± where the data cannot tell, and then said so by "?"."""
    if not (math.isfinite(std) and std > 0):
        return _local(f"{value:.4g} (?)", said)
    return _local(f"{differing_number(value, std)} ± {differing_number(std, std)}", said)


def _widths(
    model: Model, changes: Mapping[tuple[str, int, int], str], said: Mapping[str, str]
) -> tuple[float, float]:
    """Widths of a mass and of a spring between which every number of the drawing has its room."""
    chains, std = model.chains, model.std
    inside, between = [0.0], [0.0]
    for i in range(chains.branches):
        count = int(chains.masses[i].size)
        inside += [text_width(mass_name(q, count, said), 13.0) for q in range(1, count + 1)]
        inside += [
            text_width(_number(v, s, said)) for v, s in zip(chains.masses[i], std.masses[i], strict=True)
        ]
        for kind, values, spreads in (
            ("spring", chains.springs[i], std.springs[i]),
            ("damper", chains.dampers[i], std.dampers[i]),
        ):
            for s, (value, spread) in enumerate(zip(values, spreads, strict=True), 1):
                change = changes.get((kind, i, s)) if kind == "damper" else None
                text = _number(value, spread, said) + (f"  Δ {change}" if change else "")
                between.append(text_width(text))
    return max(MASS, max(inside) + 2 * MARGIN), max(SPRING, max(between) + MARGIN)


# --- elements -----------------------------------------------------------------------------------------
def _row(
    model: Model,
    axis: int,
    where: Places,
    changes: Mapping[tuple[str, int, int], str],
    said: Mapping[str, str],
) -> str:
    chains, y = model.chains, where.rows[axis]
    parts = [text_at(4, y + 5, label(chains.axes[axis], 6), font_weight="700", font_size="15")]
    count = int(chains.masses[axis].size)
    for q in range(1, count + 1):
        mass = _number(chains.masses[axis][q - 1], model.std.masses[axis][q - 1], said)
        parts.append(_mass(where, q, axis, (mass_name(q, count, said), mass), changes.get(("mass", axis, q))))
    for s in range(1, count):
        stiffness = _number(chains.springs[axis][s - 1], model.std.springs[axis][s - 1], said)
        damping = _number(chains.dampers[axis][s - 1], model.std.dampers[axis][s - 1], said)
        at = where.spring(s), y, where.gap
        parts.append(_spring(at, stiffness, changes.get(("spring", axis, s))))
        parts.append(_damper(at, damping, changes.get(("damper", axis, s))))
    if chains.ground_springs[axis] != 0:
        value = _number(chains.ground_springs[axis], model.std.ground_springs[axis], said)
        parts.append(text_at(LEFT, y + BELOW + 8, said["held"].format(value=value), font_size="11.5"))
    return f"<g>{''.join(parts)}</g>"


def mass_name(number: int, count: int, said: Mapping[str, str] = WORDS) -> str:
    """ "motor", "mass 2", "load"; of an axis with one mass "motor and load"."""
    if count == 1:
        return said["single"]
    return (
        said["motor"] if number == 1 else said["load"] if number == count else said["mass"].format(n=number)
    )


def _mass(where: Places, number: int, axis: int, texts: tuple[str, str], change: str | None) -> str:
    (name, value), x, y = texts, where.mass(number), where.rows[axis]
    box = (
        f'<rect x="{x:g}" y="{y - 25:g}" width="{where.box:g}" height="50" rx="{22 if number == 1 else 3}" '
        f'fill="{PAPER}" {_ink(change, 1.6, 4)}/>'
    )
    middle, size = x + where.box / 2, "13" if len(name) < 12 else "12"
    return (
        box
        + text_at(middle, y - 3, name, text_anchor="middle", font_weight="600", font_size=size)
        + text_at(middle, y + 15, value, text_anchor="middle", font_size="12")
        + _delta(middle, y + 40, change)
    )


def _ink(change: str | None, thin: float, thick: float) -> str:
    """Stroke of an element, thick and coloured where it changed."""
    return f'stroke="{_CHANGED if change else INK}" stroke-width="{thick if change else thin:g}"'


def _delta(x: float, y: float, change: str | None) -> str:
    if not change:
        return ""
    return text_at(x, y, f"Δ {change}", text_anchor="middle", font_weight="700", fill=_CHANGED)


def _spring(at: tuple[float, float, float], value: str, change: str | None) -> str:
    x, y, width = at
    line, step = y - 8, (width - 28) / 8
    turns = "".join(f"L{x + 14 + step * (k + 0.5):g} {line + (-7 if k % 2 else 7):g}" for k in range(8))
    path = f"M{x:g} {line:g}h14{turns}L{x + width - 14:g} {line:g}h14"
    return (
        f'<path d="{path}" fill="none" {_ink(change, 1.6, 3.5)}/>'
        + text_at(x + width / 2, y - 21, value, text_anchor="middle", font_size="12")
        + _delta(x + width / 2, y - 36, change)
    )


def _damper(at: tuple[float, float, float], value: str, change: str | None) -> str:
    x, y, width = at
    line, middle = y + 13, x + width / 2
    piston = f"M{x:g} {line:g}H{middle - 2:g}M{middle - 2:g} {line - 5:g}v10"
    pot = f"M{middle - 10:g} {line - 7:g}H{middle + 8:g}v14H{middle - 10:g}"
    path = f"{piston}{pot}M{middle + 8:g} {line:g}H{x + width:g}"
    shown = f"{value}  Δ {change}" if change else value
    more = {"font_weight": "700", "fill": _CHANGED} if change else {}
    return f'<path d="{path}" fill="none" {_ink(change, 1.4, 3)}/>' + text_at(
        middle, y + 35, shown, text_anchor="middle", font_size="12", **more
    )


def _couplings(
    model: Model, where: Places, changes: Mapping[tuple[str, int, int], str], said: Mapping[str, str]
) -> str:
    parts = []
    for lane in where.lanes:
        i, j = lane.pair
        change = changes.get(("coupling", i, j))
        colour = _CHANGED if change else _QUIET
        for axis in (i, j):
            start = where.mass(int(model.chains.masses[axis].size)) + where.box
            y = where.rows[axis]
            parts.append(f'<path d="M{start:g} {y:g}H{lane.x:g}" stroke="{_QUIET}" fill="none"/>')
            parts.append(f'<circle cx="{lane.x:g}" cy="{y:g}" r="3.5" fill="{colour}"/>')
        ends = f"M{lane.x:g} {where.rows[i]:g}V{where.rows[j]:g}"
        parts.append(
            f'<path d="{ends}" stroke="{colour}" stroke-width="{4 if change else 1.6}" fill="none"/>'
        )
        value = _number(model.chains.couplings[i, j], model.std.couplings[i, j], said).split(" ± ")[0]
        x, y = lane.x + 14, where.rows[i] + (where.rows[i + 1] - where.rows[i]) / 2
        shown = f"{value} Δ {change}" if change else value
        turn = f"rotate(-90 {x:g} {y:g})"
        parts.append(text_at(x, y, shown, text_anchor="middle", font_size="12", transform=turn, fill=colour))
    return f"<g>{''.join(parts)}</g>"


def _legend(model: Model, where: Places, said: Mapping[str, str]) -> tuple[str, float]:
    """The units, in as many lines as they need; and the height of the whole drawing."""
    unit = units(model.linear)
    lines, y = [""], where.height
    for word in said["units"].format(**unit).split(" "):
        if len(lines[-1]) + len(word) > where.width / 6.0:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    texts = [text_at(4, y + 14 + 15 * k, line, font_size="11.5", fill=_QUIET) for k, line in enumerate(lines)]
    return "".join(texts), y + 20 + 15 * (len(lines) - 1)


def description(
    model: Model, marks: Sequence[Mark], changes: Mapping[tuple[str, int, int], str], said: Mapping[str, str]
) -> list[str]:
    """Return the drawing in sentences, one an axis, one a coupling and one a finding."""
    chains, std, unit = model.chains, model.std, units(model.linear)

    def told(key: tuple[str, int, int], value: float, spread: float, of: str) -> str:
        change = changes.get(key)
        more = f" ({said['changed'].format(change=change)})" if change else ""
        return f"{_number(value, spread, said)} {of}{more}"

    out = []
    for i, axis in enumerate(chains.axes):
        count, parts = int(chains.masses[i].size), []
        for q in range(1, count + 1):
            value = told(("mass", i, q), chains.masses[i][q - 1], std.masses[i][q - 1], unit["mass"])
            parts.append(f"{mass_name(q, count, said)} {value}")
            if q < count:
                k = told(("spring", i, q), chains.springs[i][q - 1], std.springs[i][q - 1], unit["stiffness"])
                d = told(("damper", i, q), chains.dampers[i][q - 1], std.dampers[i][q - 1], unit["damping"])
                parts.append(f"{said['spring'].format(n=q)} {k}, {said['damper']} {d}")
        out.append(f"{printable(axis, 60)}: {'; '.join(parts)}.")
    for i in range(chains.branches):
        for j in range(i + 1, chains.branches):
            if chains.couplings[i, j] != 0:
                pair = f"{chains.axes[i]}–{chains.axes[j]}"
                value = told(("coupling", i, j), chains.couplings[i, j], std.couplings[i, j], unit["mass"])
                out.append(f"{printable(said['coupling'].format(pair=pair), 140)}: {value}.")
    for m in marks:
        out.append(f"{m.number or '?'}: {printable(_where(m, model, said), 140)}, {m.text}: {said[m.grade]}.")
    return out


def _where(m: Mark, model: Model, said: Mapping[str, str]) -> str:
    kind, i, at = m.place
    axes = model.chains.axes
    if kind == "coupling":
        return said["coupling"].format(pair=f"{axes[i]}–{axes[at]}")
    if kind == "spring":
        return f"{axes[i]} {said['spring'].format(n=at)}"
    return f"{axes[i]} {mass_name(at, int(model.chains.masses[i].size), said)}"
