"""A spring between two loads so strong that the linear fit without it is lost: sought from where it shows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from invid.diagnosis.evidence import Trial, attempted
from invid.diagnosis.linear_fit import highest_line
from invid.diagnosis.thresholds import CLOSE
from invid.identification.lowest_lines import rigid
from invid.likelihood.joint_fit import JointFit
from invid.likelihood.placed_effect import Candidate, Term
from invid.likelihood.tempered_fit import graduated
from invid.numerics.arrays import Float64
from invid.signals.spectral_record import Record

HEAVY = 2.0
"""How many times the inertia that the lowest lines show a branch must have to count as lost. A guess: tied
loads had 200 times theirs, and flexibility makes the lowest lines show too much, not too little."""
LEFT_OVER = 0.2
"""Share of a branch that a final mass has at least where it is the rest of the others."""
SPREAD = (0.6, 0.85, 0.35, 0.2)
"""Where a split load's own mode starts, over the highest excited line; as ``linear_fit.restarted``."""
SHARES = (0.1, 1.0)
"""Of the stiffness that the lowest lines show, which is too large by what the branches bend."""


def tied_loads(
    here: JointFit, train: Sequence[Record], held: Sequence[Record], terms: Sequence[Term]
) -> list[Trial]:
    """Springs between loads that a linear fit answered with loads many times as heavy as they are.

    Two heavy loads whose inertia is coupled nearly in full can move together only, which is the nearest that
    a linear model comes to a spring between them. Then all of their chains is wrong. The lowest lines still
    say what the machine weighs and what ties it, and what the chains bend above them is kept where it can be.
    """
    if here.candidate.terms:
        return []
    out = []
    for term in terms:
        if term.effect.cause != "coupling_stiffness":
            continue
        pair = (term.place.axis, term.place.other)
        inertia, stiffness = rigid(train, here.layout.structure.motors, pair)
        heavy = [i for i in pair if _masses(here, i).sum() > HEAVY * inertia[i] > 0.0]
        if not heavy or stiffness <= 0.0:
            continue
        best: Trial | None = None
        for p, share in _starts(here, inertia, heavy, train):
            start = Candidate((term,), (np.array([share * stiffness]),))
            trial = attempted(partial(graduated, here, train, p, start), held)
            if trial is not None and (best is None or trial.fit.cost < best.fit.cost):
                best = trial
            if best is not None and best.fit.cost < CLOSE * best.fit.dof:
                break
        if best is not None and best.fit.cost < here.cost:
            out.append(best)
    return out


def _masses(here: JointFit, axis: int) -> Float64:
    structure = here.layout.structure
    masses: Float64 = structure.chains(here.p[: structure.count]).masses[axis]
    return masses


def _starts(
    here: JointFit, inertia: Float64, heavy: Sequence[int], train: Sequence[Record]
) -> Iterator[tuple[Float64, float]]:
    """(n,) parameters whose heavy branches weigh what the lowest lines show, and shares of the stiffness.

    The final mass is what the others leave. Where they leave next to nothing, the one before stands for both,
    and is split.
    """
    structure = here.layout.structure
    top = highest_line(train)
    chains = structure.chains(here.p[: structure.count])
    for part in SPREAD:
        masses, springs = [m.copy() for m in chains.masses], [k.copy() for k in chains.springs]
        split = False
        for i in heavy:
            rest = inertia[i] - masses[i][:-1].sum()
            if rest > LEFT_OVER * inertia[i] or masses[i].size < 3:
                masses[i][-1] = max(rest, LEFT_OVER * inertia[i])
                continue
            split = True
            half = 0.5 * max(inertia[i] - masses[i][:-2].sum(), LEFT_OVER * inertia[i])
            masses[i][-2:] = half
            springs[i][-1] = half * (part * top) ** 2 / 2
        p = here.p.copy()
        loose = replace(
            chains,
            masses=tuple(masses),
            springs=tuple(springs),
            couplings=np.zeros_like(chains.couplings),
        )
        p[: structure.count] = structure.vector(loose)
        for share in SHARES:
            yield p, share
        if not split:
            return


__all__ = ["tied_loads"]
