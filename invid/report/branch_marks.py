"""Marks of findings in the drawing of the branches: number, shape and colour at the place, text below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from invid.report.branch_places import LEFT, Place, Places

INK, PAPER = "var(--ink, #1b1c1d)", "var(--card, var(--paper, #ffffff))"
_COLOURS = {
    "act": "var(--act, #b3261e)",
    "watch": "var(--watch, #8a5a00)",
    "as_expected": "var(--fine, #00664a)",
    "ungraded": "var(--ink, #1b1c1d)",
}


@dataclass(frozen=True)
class Mark:
    """A finding at its place; ``number`` is its place in the list of findings, from 1."""

    number: int
    place: Place
    grade: str
    text: str


def text_at(x: float, y: float, text: str, **attributes: str) -> str:
    """One line of text; attributes as in SVG with "_" for "-"."""
    more = "".join(f' {k.replace("_", "-")}="{v}"' for k, v in attributes.items())
    return f'<text x="{x:g}" y="{y:g}"{more}>{escape(text)}</text>'


def _bubble(x: float, y: float, m: Mark) -> str:
    """Triangle: act; diamond: watch; circle: as expected; square: no grade. Not by colour alone."""
    shapes = {
        "act": f"M{x:g} {y - 12:g}L{x + 12:g} {y + 9:g}H{x - 12:g}Z",
        "watch": f"M{x:g} {y - 12:g}L{x + 12:g} {y:g}L{x:g} {y + 12:g}L{x - 12:g} {y:g}Z",
        "as_expected": f"M{x - 9.5:g} {y:g}a9.5 9.5 0 1 0 19 0a9.5 9.5 0 1 0 -19 0Z",
        "ungraded": f"M{x - 9:g} {y - 9:g}h18v18h-18Z",
    }
    colour = _COLOURS[m.grade]
    filled = m.grade in ("act", "watch")
    fill = colour if filled else PAPER
    shape = f'<path d="{shapes[m.grade]}" fill="{fill}" stroke="{colour}" stroke-width="2"/>'
    low = 6.5 if m.grade == "act" else 4
    return shape + text_at(
        x,
        y + low,
        str(m.number) if m.number else "?",
        text_anchor="middle",
        font_size="11.5",
        font_weight="700",
        fill=PAPER if filled else colour,
    )


def marked(where: Places, marks: Sequence[Mark]) -> str:
    """All marks of one place, side by side."""
    kind, i, at = marks[0].place
    parts = []
    for k, m in enumerate(marks):
        if kind == "coupling":
            x = next(lane.x for lane in where.lanes if lane.pair == (i, at))
            y = (where.rows[i] + where.rows[i + 1]) / 2 + 34 - 22 * k
        elif kind == "spring":
            x, y = where.spring(at) + 13 + 25 * k, where.rows[i] - 42
        else:
            x, y = where.mass(at) + 13 + 25 * k, where.rows[i] - 32
        parts.append(_bubble(x, y, m))
    return f"<g>{''.join(parts)}</g>"


def room_of(text: str) -> float:
    """Width of a line with its mark: about 7.2 units a letter."""
    return 7.2 * len(text) + 36


def callout(m: Mark, where: Places, y: float) -> str:
    """The mark again with its text, below its element where there is room."""
    kind, _, at = m.place
    x = where.mass(at) if kind == "mass" else where.spring(at) if kind == "spring" else LEFT
    x = max(4.0, min(x, where.width - room_of(m.text)))
    return f"<g>{_bubble(x + 12, y, m)}{text_at(x + 28, y + 4.5, m.text)}</g>"
