"""Where each element of the branches stands in their drawing, and at which of them a finding acts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm, Model

LEFT, MASS, SPRING = 54.0, 112.0, 104.0
"""Widths of the axis' name, of a mass and of a spring, in units of the drawing."""
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

    @staticmethod
    def mass(number: int) -> float:
        """Left edge of a mass, counted from the motor, from 1."""
        return LEFT + (number - 1) * (MASS + SPRING)

    @staticmethod
    def spring(number: int) -> float:
        """Left end of a spring."""
        return LEFT + number * MASS + (number - 1) * SPRING


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


def places(model: Model, marked: Sequence[Place], widest: float = 0.0) -> Places:
    """Rows one below the other, as high as their findings ask; couplings to the right, none over another.

    ``widest`` is the room that the longest line of text takes.
    """
    chains = model.chains
    lines = [lines_below(chains, i) + sum(p[1] == i for p in marked) for i in range(chains.branches)]
    rows, y = [], 8.0
    for count in lines:
        rows.append(y + ABOVE)
        y += ABOVE + BELOW + LINE * count
    longest = max(m.size for m in chains.masses)
    right = LEFT + longest * MASS + (longest - 1) * SPRING + 20.0
    lanes = _lanes(model, right, {(p[1], p[2]) for p in marked if p[0] == "coupling"})
    width = max([right - 12.0, LEAST_WIDTH, widest, *(lane.x + 24.0 for lane in lanes)])
    return Places(tuple(rows), tuple(lanes), width, y)


SURELY = 3.0
"""Standard deviations from which a coupling is drawn."""


def _lanes(model: Model, right: float, asked: set[tuple[int, int]]) -> list[Lane]:
    """Short couplings first; each in the first lane that is free between its rows.

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


def changed_places(names: Mapping[str, str], chains: CoupledChains) -> dict[tuple[str, int, int], str]:
    """Texts of changed parameters ("A1.spring.2": "+12 %") by kind, axis and number."""
    kinds = {"mass": "mass", "spring": "spring", "damper": "damper"}
    found: dict[tuple[str, int, int], str] = {}
    for name, text in names.items():
        front, _, number = name.rpartition(".")
        axis, _, kind = front.rpartition(".")
        if number.isdigit() and kind in kinds and axis in chains.axes:
            found[kind, chains.axes.index(axis), int(number)] = text
        elif number == "coupling":
            for i, one in enumerate(chains.axes):
                for j, other in enumerate(chains.axes):
                    if i < j and front == f"{one}-{other}":
                        found["coupling", i, j] = text
    return found
