"""Place the elements of the drawing of the branches, and the marks of findings and changes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm, Model

INK, PAPER = "var(--ink, #1b1c1d)", "var(--card, var(--paper, #ffffff))"
COLOURS = {
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


def bubbles_of(marks: Sequence[Mark], where: Places) -> list[tuple[float, float, Mark]]:
    """Where each mark stands at its element, those of one place side by side."""
    found, before = [], Counter[Place]()
    for m in marks:
        kind, i, at = m.place
        k = before[m.place]
        before[m.place] += 1
        if kind == "coupling":
            x = next(lane.x for lane in where.lanes if lane.pair == (i, at))
            found.append((x, (where.rows[i] + where.rows[i + 1]) / 2 + 34 - 22 * k, m))
        elif kind == "spring":
            found.append((where.spring(at) + 13 + 25 * k, where.rows[i] - 42, m))
        else:
            found.append((where.mass(at) + 13 + 25 * k, where.rows[i] - 32, m))
    return found


def callouts_of(
    marks: Sequence[Mark], where: Places, chains: CoupledChains
) -> list[tuple[float, float, Mark]]:
    """Where each mark stands again with its text, below its element where there is room."""
    found, lines = [], [lines_below(chains, i) for i in range(chains.branches)]
    for m in marks:
        kind, i, at = m.place
        x = where.mass(at) if kind == "mass" else where.spring(at) if kind == "spring" else LEFT
        x = max(4.0, min(x, where.width - room_of(m.text)))
        found.append((x, where.rows[i] + BELOW + 6 + lines[i] * LINE, m))
        lines[i] += 1
    return found


def room_of(text: str) -> float:
    """Width of a line with its mark: about 7.2 units a letter."""
    return 7.2 * len(text) + 36


LEFT, MASS, SPRING = 54.0, 112.0, 104.0
"""Least widths of the axis' name, of a mass and of a spring, in units of the drawing."""
MARGIN = 8.0
"""Room on either side of a number in its box."""
LANE = 26.0
LEAST_WIDTH = 430.0
ABOVE, BELOW, LINE = 56.0, 50.0, 22.0
"""Of a row: room above and below its middle, and for each line of a finding."""

Place = tuple[str, int, int]
"""("mass" or "spring", axis, number from 1) or ("coupling", axis, other axis), axes by number."""


@dataclass(frozen=True)
class Lane:
    """The coupling of two final masses: a vertical line right of all chains."""

    pair: tuple[int, int]
    x: float


@dataclass(frozen=True)
class Places:
    """Geometry of the drawing: the middle of each row, the lanes of couplings, the size of it all."""

    rows: tuple[float, ...]
    lanes: tuple[Lane, ...]
    width: float
    height: float
    box: float = MASS
    """Width of a mass."""
    gap: float = SPRING
    """Width of a spring."""

    ends: tuple[float, ...] = ()
    """Right edges of the final masses."""

    def mass(self, number: int) -> float:
        """Left edge of a mass, counted from the motor, from 1."""
        return LEFT + (number - 1) * (self.box + self.gap)

    def spring(self, number: int) -> float:
        """Left end of a spring."""
        return LEFT + number * self.box + (number - 1) * self.gap


def place_of(term: EffectTerm, chains: CoupledChains) -> Place:
    """The element that an effect acts at.

    What sits in the drive or the encoder is shown at the motor; a load that the cause does not place is
    the final mass.
    """
    axis = chains.axes.index(term.axis)
    if term.other_axis in chains.axes and term.other_axis != term.axis:
        other = chains.axes.index(term.other_axis)
        return "coupling", min(axis, other), max(axis, other)
    kind, _, number = (term.element or "").partition(" ")
    at = int(number) if number.isdigit() else 0
    if kind == "spring" and 1 <= at <= chains.springs[axis].size:
        return "spring", axis, at
    if kind == "mass" and 1 <= at <= chains.masses[axis].size:
        return "mass", axis, at
    outer = term.cause in ("gravity", "payload_change", "extra_mode")
    return "mass", axis, int(chains.masses[axis].size) if outer else 1


def lines_below(chains: CoupledChains, axis: int) -> int:
    """Lines of a row before its findings: one where the motor is held to ground."""
    return int(chains.ground_springs[axis] != 0)


def text_width(text: str, size: float = 12.0) -> float:
    """Width of a line of numbers in a wide font (DejaVu Sans), where a digit takes 0.64 of its size."""
    return size * sum(0.33 if c in " .,|" else 0.84 if c in "±−+Δ→" else 0.64 for c in text)


def places(
    model: Model, marked: Sequence[Place], widest: float = 0.0, *, box: float = MASS, gap: float = SPRING
) -> Places:
    """Lay out the rows one below the other, as high as their findings ask; couplings to the right, none
    over another.

    ``widest`` is the room that the longest line takes, ``box`` and ``gap`` the widths of a mass and of
    a spring that their numbers need.
    """
    chains = model.chains
    lines = [lines_below(chains, i) + sum(p[1] == i for p in marked) for i in range(chains.branches)]
    rows, y = [], 8.0
    for count in lines:
        rows.append(y + ABOVE)
        y += ABOVE + BELOW + LINE * count
    longest = max(m.size for m in chains.masses)
    right = LEFT + longest * box + (longest - 1) * gap + 20.0
    lanes = _lanes(model, right, {(p[1], p[2]) for p in marked if p[0] == "coupling"})
    width = max([right - 12.0, LEAST_WIDTH, widest, *(lane.x + 24.0 for lane in lanes)])
    ends = tuple(LEFT + m.size * box + (m.size - 1) * gap for m in chains.masses)
    return Places(tuple(rows), tuple(lanes), width, y, box, gap, ends)


SURELY = 3.0
"""Standard deviations from which a coupling is drawn."""


def _lanes(model: Model, right: float, asked: set[tuple[int, int]]) -> list[Lane]:
    """Give couplings their lanes, short ones first: each the first that is free between its rows.

    One that does not stand out of its own noise is left out: of fifteen pairs of six axes few are coupled.
    """
    chains, std = model.chains, model.std.couplings
    pairs = [
        (i, j)
        for i in range(chains.branches)
        for j in range(i + 1, chains.branches)
        if (i, j) in asked or abs(chains.couplings[i, j]) > SURELY * np.nan_to_num(std[i, j], posinf=0.0)
    ]
    taken: list[list[tuple[int, int]]] = []
    found = []
    for i, j in sorted(pairs, key=lambda p: (p[1] - p[0], p[0])):
        free = next((k for k, lane in enumerate(taken) if all(j <= a or b <= i for a, b in lane)), len(taken))
        if free == len(taken):
            taken.append([])
        taken[free].append((i, j))
        found.append(Lane((i, j), right + LANE * free))
    return found
