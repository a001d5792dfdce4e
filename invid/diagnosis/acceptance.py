"""Whether a cause is there: what its gain has to be, against chance and against what other causes leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from invid.diagnosis.evidence import (
    CandidateEvidence,
    evidence_if_finite,
    excess_chi2,
    is_significant_at_shapes,
    is_size_significant,
)
from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import (
    CLOSE,
    HELD_OUT,
    NAMED_SHARE,
    REACHED,
    REMAINDER,
    SHARE,
    SIGNIFICANCE,
    SMALL_REMAINDER,
    WEAK,
)
from invid.likelihood.joint_fit import JointFit, fit
from invid.likelihood.placed_effect import PlacedEffect
from invid.model.place import Place
from invid.numerics import budget
from invid.numerics.distributions import chi2_isf
from invid.signals.spectral_record import SpectralRecord


def least_gain(here: JointFit, term: PlacedEffect, count: int, *, first: bool) -> float:
    """Gain of training χ² below which a cause cannot be accepted."""
    significant = chi2_isf(SIGNIFICANCE / count, 1)
    if first:
        return significant
    return max(significant, SMALL_REMAINDER * excess_chi2(here.evaluation, _axes(term.place)))


def needed_gain(current: CandidateEvidence, trial: CandidateEvidence, count: int, *, rejects: bool) -> float:
    """Gain of χ² that a cause needs of ``count`` to be there; ``rejects``: the records ask for one."""
    unknowns = max(trial.term.size + trial.starts - current.starts, 1)
    return chi2_isf((SIGNIFICANCE if rejects else WEAK) / count, unknowns)


def _axes(place: Place) -> set[int]:
    """The axes that a cause is between, or sits on."""
    return {place.axis} if place.other < 0 else {place.axis, place.other}


def is_accepted(
    current: CandidateEvidence,
    trial: CandidateEvidence,
    dispersion: tuple[float, float],
    count: int,
    start: CandidateEvidence,
    *,
    first: bool,
    rejects: bool,
    quiet: bool,
    small: bool = False,
) -> bool:
    """Whether a cause is there; ``rejects``: all records ask for one, ``quiet``: the training does not.

    ``small``: also where it is small beside the first, for as long as nobody names it (``provisional``).

    ``dispersion``: χ²/ν of the best candidate on the training records and on those held out. Each part by its
    own: what a record far finer than the rest misses says nothing of the gain on those.
    """
    gain = (current.fit.cost - trial.fit.cost) / dispersion[0]
    held_gain = (current.held.cost - trial.held.cost) / dispersion[1]
    needed = needed_gain(current, trial, count, rejects=rejects)
    # Where there is no excess to explain every record counts: noise that was fitted costs on the held-out
    # ones what it gained, so the sum passes no more often than the gain of a fit to all of them.
    if rejects and quiet and gain < needed:
        # The held-out records show it, being of another amplitude: what little the training says of it takes
        # nearly all that they miss, which a cause fitted to noise does not.
        left = trial.held.cost - trial.held.dof
        if left > (1.0 - NAMED_SHARE) * (current.held.cost - current.held.dof):
            return False
        gain += held_gain
    if (gain if rejects else gain + held_gain) < needed or held_gain < HELD_OUT:
        return False
    if trial.term.effect.is_null(trial.x.tolist()):
        return False
    # An encoder of few counts errs alike in every period, on a handful of lines, which χ² takes for noise. By
    # the scatter over the lines, which does not, the size has to differ from none as well.
    if not rejects and is_significant_at_shapes(trial.fit, -1, SIGNIFICANCE / count) is False:
        return False
    if first:
        return True
    excess, gained = current.excess, current.cost - trial.cost
    reached, takes_all = trial.cost < CLOSE * trial.dof, gained > NAMED_SHARE * excess
    if not (reached and takes_all) and is_significant_at_shapes(trial.fit, -1) is False:
        return False  # beside a weight a thousand times all else what is left has a shape, and no size
    remainder = SMALL_REMAINDER if small else REMAINDER
    if gained < remainder * current.excess_on(_axes(trial.term.place)):
        return False
    if small:
        return True
    # Where the model stays far from the noise, what little a further cause removes may be any cause's.
    if trial.cost < REACHED * trial.dof and takes_all:
        return True
    # What an imperfect model of the first cause leaves was up to 0.3 % of it on hidden plants.
    share = 0.01 if reached else SHARE
    return gained > share * start.excess_in_motion


def is_asked_for(without: CandidateEvidence, trial: CandidateEvidence) -> bool:
    """Whether the training records ask for a friction law and the held-out ones do not refuse it."""
    gain = (without.fit.cost - trial.fit.cost) / trial.dispersion
    return gain > chi2_isf(WEAK, 1) and trial.held.cost < without.held.cost


def drop_insignificant_causes(
    found: Selection,
    small: set[tuple[str, Place]],
    train: Sequence[SpectralRecord],
    held: Sequence[SpectralRecord],
) -> Selection:
    """The selection without causes of these names whose size is not significant beside those found later."""
    known, final = len(found.base.fit.candidate.terms), found.final.fit
    lost = [
        n
        for n, s in enumerate(found.steps)
        if (s.chosen.term.effect.cause, s.chosen.term.place) in small
        and is_size_significant(final, known + n, SIGNIFICANCE) is False
    ]
    if not lost or len(lost) == len(found.steps) or budget.is_spent():
        return found
    number = lost[-1]
    fewer = partial(fit, final.layout, train, final.p, final.candidate.without(known + number), iterations=25)
    rest = evidence_if_finite(fewer, held)
    if rest is None:
        return found
    steps = (*found.steps[:number], *found.steps[number + 1 :])
    return drop_insignificant_causes(replace(found, final=rest, steps=steps), small, train, held)
