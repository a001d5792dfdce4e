"""A mode so strong that the linear fit without it is lost: sought through noise of a share of the torque."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from invid.diagnosis.evidence import Trial, attempted, finite
from invid.diagnosis.linear_fit import highest_line
from invid.diagnosis.thresholds import CLOSE
from invid.effects.registry import BY_CAUSE
from invid.likelihood.joint_fit import JointFit
from invid.likelihood.placed_effect import Candidate, Term
from invid.likelihood.tempered_fit import ROUGH, graduated
from invid.signals.spectral_record import Record

MASS = 0.1
"""Of its branch, that a mode starts with. A guess: from a fiftieth few starts moved at all."""
PLACES = (0.3, 0.45, 0.65, 0.9)
"""Where it starts, over the highest excited line: a resonance a quarter aside is in reach of a rough fit."""
DAMPING = 0.02
STEPS = (4, 8, 12)
"""Of all starts at a place, of the better two, and of the best one, which then compete with other places'."""
FEW = 3
"""Places that are followed down to the sensors' noise."""


def strong_modes(here: JointFit, train: Sequence[Record], held: Sequence[Record]) -> list[Trial]:
    """Modes beside the chains from starts at every mass, those that end close to the noise.

    A heavy mode is a resonance of its own, and a chain without it puts one of its own there: then the screen,
    which asks what beside that chain takes most, asks at the wrong one. Nor does any step lead back. Here
    chains and mode are fitted together from the first, roughly at first, the better half of a place's starts
    going on (successive halving).
    """
    effect = BY_CAUSE["extra_mode"]
    places = [_at_place(here, train, Term(effect, p)) for p in effect.places(here.layout.structure)]
    best = sorted((found[0] for found in places if found), key=lambda f: f.cost)[:FEW]
    out: list[Trial] = []
    for rough in best:
        trial = attempted(partial(graduated, here, train, rough.p, rough.candidate), held)
        if trial is not None and trial.fit.cost < CLOSE * trial.fit.dof:
            out.append(trial)
    return out


def _at_place(here: JointFit, train: Sequence[Record], term: Term) -> list[JointFit]:
    """The best rough fit with a mode at one place; none where no start leads anywhere."""
    structure, top = here.layout.structure, highest_line(train)
    branch = structure.chains(here.p[: structure.count]).masses[term.place.axis]
    starts = []
    for part in PLACES:
        x = np.array([MASS * float(branch.sum()), np.log(part * top), np.log(DAMPING)])
        starts.append((here.p, Candidate((term,), (x,))))
    going: list[JointFit] = []
    for number, steps in enumerate(STEPS):
        tried = (finite(partial(graduated, here, train, p, x, ROUGH[:1], steps)) for p, x in starts)
        going = sorted((t for t in tried if t is not None), key=lambda t: t.cost)
        going = going[: max(len(PLACES) >> (number + 1), 1)]
        starts = [(t.p, t.candidate) for t in going]
    return going


__all__ = ["strong_modes"]
