"""Measure how heavy an axis is by its trial, and compare that with what is stated.

A wrong scale of torque or position makes an axis look lighter or heavier by the same factor. What a trial
shows lies between two bounds. A jump of torque accelerates the first mass alone (1/m₁, springs do not matter
at once), so the first mass can never be heavier than the whole branch; a doublet slower than the modes moves
the whole branch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from invid.errors import SafetyStop
from invid.numerics.arrays import Bool, Float64
from invid.planning.phases import SLOW_S
from invid.wording.sentence import sentence

AGREES = 3.0
"""Stated and measured inertia may differ by this factor. "Roughly" in a config, a tool that was changed, and
what friction and modes leave to a trial stay within two (a guess for the first, measured on the case study
for the last); what goes wrong with scales is 4 (lines taken for counts), 10 (a unit), 16 (bits) or a gear."""
NOTED = 0.25
"""Beyond this share a difference is worth a line: a trial is good to ten per cent or so (case study)."""
RIGID = 0.02
"""Where no more than this share of the path is left over in a doublet of at least ``SLOW_S``, the axis moved
as a rigid mass with friction, and its inertia is known: 0.7 to 2.1 times the true one on 100 elastic cells
with lowest modes from 1 to 5 Hz (``tests/machines``, empirical)."""
ELASTIC, ELASTIC_S = 6.0, 1.0
"""An axis that swings shows less or more of itself: what its motor moves in a doublet of this length was
0.3 to 2.2 times of it, once 57 times (empirical, 160 cells). Six times too light is then a scale for sure."""
HEAVY_FITS = 0.15
"""Too heavy only where no more of the path is left over. Chosen on the one of 60 healthy cells that looked 57
times too heavy (0.26) and 25 with a scale ten times wrong (0.1, one 0.23); not tried on fresh cells yet."""
FITS = 0.3
"""Where more than this share of the path is left over, the axis did not move as a mass with friction: the
elastic axes of the case study leave 0.2 at most, one that only bends against what holds it more."""
HELD_BACK = 0.6
"""Friction over torque above which the fit says nothing of the mass: a spring that holds the motor back looks
like friction, and the slow doublets have twice the friction that was seen."""
BY_TORQUE = 0.5
"""Share of the path that torque must make for its sign to be told by it."""
SLIDES = 2.0
"""Counts within a twentieth of the doublet from which the axis counts as sliding."""


@dataclass(frozen=True)
class Branch:
    """A rigid mass with dry friction that moves as the axis did."""

    inertia: float
    """[kg·m² or kg]; below zero where torque moved it the opposite way."""
    friction: float
    """[N·m or N]"""
    left: float
    """What is left of the path, rms, as a share of its range."""
    length_s: float
    """Of the doublet."""
    torque: float
    """Peak of the doublet [N·m or N]."""
    by_torque: float
    """Range of the path that the torque makes alone, as a share of the whole."""

    @property
    def fits(self) -> bool:
        """Return whether the axis moved as a rigid mass, by more of the torque than friction took."""
        moved = 0 < self.inertia < math.inf and self.friction <= HELD_BACK * self.torque
        return moved and self.left <= FITS

    @property
    def rigid(self) -> bool:
        """Return whether it moved so rigidly, in a doublet so slow, that its inertia is known."""
        return self.left <= RIGID and self.length_s >= SLOW_S

    @property
    def is_opposed(self) -> bool:
        """Whether torque moved a rigid mass the opposite way, and nothing else did: no drift, no friction.

        None in 40,000 doublets on elastic chains, free or on springs, that rang before.
        """
        slid = abs(self.friction) <= HELD_BACK * self.torque
        return self.inertia < 0 and self.rigid and slid and self.by_torque >= BY_TORQUE

    def differs(self, stated: float) -> bool:
        """Return whether its inertia is so far from a stated one that no elastic axis explains it."""
        ratio = self.inertia / stated
        if self.rigid:
            return not 1.0 / AGREES <= ratio <= AGREES
        heavy = ratio > ELASTIC and self.left <= HEAVY_FITS
        return self.length_s >= ELASTIC_S and (ratio < 1.0 / ELASTIC or heavy)


def rigid_branch(time: Float64, demand: Float64, position: Float64, fresh: Bool, *, count: float) -> Branch:
    """Fit x'' = (τ − f·sign x')/J to a doublet, integrated twice, by least squares.

    Parameters
    ----------
    time
        (n,) SYNC instants [s].
    demand, position
        (n,) torque around its value at rest, and position.
    fresh
        (n,) rows whose position came with its SYNC.
    count
        Position of one encoder count.
    """
    acting = np.flatnonzero(demand)
    step = float(np.median(np.diff(time)))
    span = max(1, round(acting.size / 40))
    shown = np.interp(time, time[fresh], position[fresh])
    ahead = np.concatenate([shown[span:], np.full(span, shown[-1])])
    behind = np.concatenate([np.full(span, shown[0]), shown[:-span]])
    way = ahead - behind
    slides = np.abs(way) > SLIDES * count
    torque, friction = np.where(slides, demand, 0.0), np.where(slides, np.sign(way), 0.0)
    path_torque, path_friction = (_integrated(c, step) for c in (torque, friction))
    drift = time - time[0]
    columns = np.column_stack([path_torque, -path_friction, drift, np.ones_like(drift)])[fresh]
    x = position[fresh]
    solution = np.linalg.lstsq(columns, x, rcond=None)[0]
    if solution[1] < 0:  # friction that drives is none
        columns = columns[:, [0, 2, 3]]
        solution = np.linalg.lstsq(columns, x, rcond=None)[0]
        share = 0.0
    else:
        share = float(solution[1])
    rest = float(np.sqrt(np.mean((x - columns @ solution) ** 2)))
    reach = float(np.ptp(x))
    mobility = float(solution[0])
    inertia = 1.0 / mobility if mobility else math.inf
    return Branch(
        inertia=inertia,
        friction=share * inertia if math.isfinite(inertia) else 0.0,
        left=rest / reach if reach > 0 else math.inf,
        length_s=acting.size * step,
        torque=float(np.abs(demand).max(initial=0.0)),
        by_torque=float(np.ptp(mobility * path_torque[fresh])) / reach if reach > 0 else 0.0,
    )


def _integrated(acceleration: Float64, step: float) -> Float64:
    """Position from rest under an acceleration that is constant over each cycle."""
    velocity = np.concatenate([[0.0], np.cumsum(acceleration)[:-1]]) * step
    way = velocity * step + 0.5 * acceleration * step**2
    path: Float64 = np.concatenate([[0.0], np.cumsum(way)[:-1]])
    return path


def compare(
    axis: str,
    stated: float,
    source: str,
    *,
    first_mass: float,
    branch: Branch | None,
    unit: str,
) -> str:
    """Return what to say of a measured inertia beside the stated one, empty where they agree.

    ``first_mass`` is the lightest that the jumps of acceleration allow (0: they tell nothing), ``branch`` the
    rigid mass of the slowest doublet (``None``: it tells nothing).

    Raises
    ------
    SafetyStop
        They differ by more than a flexible axis and the trial allow.
    """
    heavy = first_mass > AGREES * stated
    if heavy or (branch is not None and branch.differs(stated)):
        found = first_mass if heavy or branch is None else branch.inertia
        raise SafetyStop(
            f"axis {axis}: "
            + ("its first mass alone is at least" if heavy else "the trial moved it like")
            + f" {found:.3g} {unit}, {source} says {stated:.3g} {unit}: more than {AGREES:g} times "
            f"{'as heavy' if found > stated else 'lighter'}, which no elastic axis explains",
            way_out="a scale is wrong, or the inertia. Compare 0x6076 (rated torque) with the motor's plate, "
            "and 0x608F, 0x6091, 0x6092 (counts of a turn) with encoder and gear; if they are right, correct "
            "the inertia. Nothing was recorded yet",
            code="scales",
            axis=axis,
        )
    if branch is None or not branch.rigid or abs(branch.inertia - stated) <= NOTED * stated:
        return ""
    return sentence(
        "axis {axis}: the trial moved it like {inertia:.3g} {unit}, {source} says "
        "{stated:.3g}; what was measured is used",
        axis=axis,
        inertia=branch.inertia,
        unit=unit,
        source=source,
        stated=stated,
    )
