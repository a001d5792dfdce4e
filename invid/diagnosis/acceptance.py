"""Acceptance tests of a cause: its gain in χ² against chance and against what other causes leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Protocol

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
    """Smallest gain of training χ² with which a cause can be accepted; ``count``: candidates tested."""
    significant = chi2_isf(SIGNIFICANCE / count, 1)
    if first:
        return significant
    return max(significant, SMALL_REMAINDER * excess_chi2(here.evaluation, _axes_of_place(term.place)))


class Trial(Protocol):
    """A cause on trial: its term, and its number of initial states."""

    @property
    def term(self) -> PlacedEffect: ...

    @property
    def starts(self) -> int: ...


def needed_gain(current: CandidateEvidence, trial: Trial, count: int, *, rejects: bool) -> float:
    """Gain of χ² that one of ``count`` candidates needs; ``rejects``: the null test rejects the model without
    it."""
    unknowns = max(trial.term.size + trial.starts - current.starts, 1)
    return chi2_isf((SIGNIFICANCE if rejects else WEAK) / count, unknowns)


def _axes_of_place(place: Place) -> set[int]:
    """Numbers of the axes that a place belongs to: one, or two for a place between axes."""
    return {place.axis} if place.other < 0 else {place.axis, place.other}


def is_accepted(  # noqa: PLR0913 - the test's own terms
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
    """Whether a cause is accepted beside those of ``current``.

    ``dispersion``: χ²/ν of the best candidate on the training and on the held-out records; each gain is
    divided by that of its own records, because one record with far less noise than the rest says nothing of
    the gain on those. ``rejects``: the null test rejects ``current`` on all records; ``quiet``: it does not
    on the training records alone. ``first``: no cause was found before. ``small``: accept a cause that is
    small beside the first as well; the search keeps it only where it ends near the noise.
    """
    gain = (current.fit.cost - trial.fit.cost) / dispersion[0]
    held_gain = (current.held.cost - trial.held.cost) / dispersion[1]
    needed = needed_gain(current, trial, count, rejects=rejects)
    # Without an excess to explain all records count together: a cause fitted to noise loses on the held-out
    # records what it gained in training, so the sum passes no more often than a fit to all records would.
    if rejects and quiet and gain < needed:
        # Only the held-out records show it, at another amplitude. A cause fitted to noise in training does
        # not explain nearly all of their excess.
        held_excess = trial.held.cost - trial.held.dof
        if held_excess > (1.0 - NAMED_SHARE) * (current.held.cost - current.held.dof):
            return False
        gain += held_gain
    if (gain if rejects else gain + held_gain) < needed or held_gain < HELD_OUT:
        return False
    if trial.term.effect.is_null(trial.x.tolist()):
        return False
    # The error of a coarse encoder repeats in every period and lies on few lines; χ² takes it for noise. So
    # the size has to be significant by the scatter over the lines as well (Wald test).
    if not rejects and is_significant_at_shapes(trial.fit, -1, SIGNIFICANCE / count) is False:
        return False
    if first:
        return True
    excess, total_gain = current.excess, current.cost - trial.cost
    is_close, takes_nearly_all = trial.cost < CLOSE * trial.dof, total_gain > NAMED_SHARE * excess
    if not (is_close and takes_nearly_all) and is_significant_at_shapes(trial.fit, -1) is False:
        return False  # the remainder of a much larger cause fits some shape, but with no significant size
    remainder = SMALL_REMAINDER if small else REMAINDER
    if total_gain < remainder * current.excess_on(_axes_of_place(trial.term.place)):
        return False
    if small:
        return True
    # Far from the noise a small gain may belong to any cause.
    if trial.cost < REACHED * trial.dof and takes_nearly_all:
        return True
    # Empirical (hidden plants): an imperfect model of the first cause leaves up to 0.3 % of it.
    share = 0.01 if is_close else SHARE
    return total_gain > share * start.excess_in_motion


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
    """The selection without those of the causes ``small`` whose size is not significant beside all others."""
    known, final = len(found.base.fit.candidate.terms), found.final.fit
    insignificant = [
        n
        for n, s in enumerate(found.steps)
        if (s.chosen.term.effect.cause, s.chosen.term.place) in small
        and is_size_significant(final, known + n, SIGNIFICANCE) is False
    ]
    if not insignificant or len(insignificant) == len(found.steps) or budget.is_spent():
        return found
    number = insignificant[-1]
    refit = partial(fit, final.layout, train, final.p, final.candidate.without(known + number), iterations=25)
    rest = evidence_if_finite(refit, held)
    if rest is None:
        return found
    steps = (*found.steps[:number], *found.steps[number + 1 :])
    return drop_insignificant_causes(replace(found, final=rest, steps=steps), small, train, held)
