"""Viscous friction beside the dry friction that was found: named, or allowed for in its size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from invid.diagnosis.acceptance import is_asked_for
from invid.diagnosis.evidence import Step, Trial, attempted
from invid.diagnosis.score_test import Screen
from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import CLOSE, LARGER, WEAK
from invid.effects.registry import BY_CAUSE
from invid.likelihood.joint_fit import fit
from invid.likelihood.placed_effect import Term
from invid.numerics.arrays import Float64
from invid.numerics.distributions import chi2_isf
from invid.signals.spectral_record import Record

DRY = ("coulomb_friction", "stribeck_friction", "presliding_friction")


def with_viscous(found: Selection, train: Sequence[Record], held: Sequence[Record]) -> Selection:
    """The selection with viscous friction at every place of dry friction where the records ask for it.

    What rubs is greased: the search for further causes asks a price for every place that each could sit at,
    and stops where the whole is no more than noise; this is one question, with one answer expected. Unasked,
    the dry friction takes what the viscous one would: 10 % of it at seven of its standard deviations. Far
    from the noise what the wrong law of dry friction leaves passes for viscous friction (a sliding law with
    other springs got 0.5 ± 1.5 N·m·s/rad), and it is not asked.
    """
    screen: Screen | None = None
    for number in range(len(found.steps)):
        viscous, final = _beside(found, number), found.final
        if viscous is None or final.cost > CLOSE * final.dof:
            continue
        if screen is None or screen.fit is not final.fit:
            screen = Screen(final.fit)
        gain, x = _score(screen, viscous)
        if gain < 0.5 * chi2_isf(WEAK, 1) * final.dispersion:
            continue  # of what a score test promises a fit never makes twice as much
        candidate = final.fit.candidate.plus(viscous, x)
        started = partial(fit, final.fit.layout, train, final.fit.p, candidate, iterations=25)
        trial = attempted(started, held)
        if trial is not None and is_asked_for(final, trial):
            found = _named(found, number, trial)
    return found


def _beside(found: Selection, number: int) -> Term | None:
    """Viscous friction where a step's dry friction is; none where it is none, or has it already."""
    terms = found.final.fit.candidate.terms
    dry = terms[len(found.base.fit.candidate.terms) + number]
    there = {t.effect.cause for t in terms if t.place == dry.place}
    if dry.effect.cause not in DRY or "viscous_friction" in there:
        return None
    return Term(BY_CAUSE["viscous_friction"], dry.place)


def allowing_for_viscous(found: Selection) -> Selection:
    """The selection with its sizes as uncertain as the viscous friction that was not named leaves them."""
    final, open_ = found.final, found
    asked = [t for t in (_beside(found, n) for n in range(len(found.steps))) if t is not None]
    if not asked:
        return found
    screen = Screen(final.fit)
    for viscous in asked:
        gain, x = screen.at(viscous, ())
        shift = screen.shift(viscous, x)
        screen.release()
        # Odds of there being any, Schwarz' penalty against the gain: one prior in two.
        odds = np.exp(min(0.5 * (gain / final.dispersion - np.log(max(final.fit.dof, 2))), 50.0))
        open_ = open_.wider(shift * np.sqrt(odds / (1.0 + odds)))
    return open_


def _score(screen: Screen, term: Term) -> tuple[float, Float64]:
    """What a further term would gain, and its parameters."""
    out = screen.at(term, ())
    screen.release()
    return out


def _named(found: Selection, number: int, trial: Trial) -> Selection:
    """With the viscous friction as a step of its own.

    Friction that differs between the directions contains both, and stays a rival only where it gains what its
    two further parameters do not by chance.
    """
    step = found.steps[number]
    place = step.chosen.term.place
    uneven = Term(BY_CAUSE["asymmetric_friction"], place)
    kept = step.ranked
    if _score(Screen(trial.fit), uneven)[0] < LARGER * trial.dispersion:
        kept = tuple(
            r for r in kept if (r[0].term.effect.cause, r[0].term.place) != (uneven.effect.cause, place)
        )
    steps = (*found.steps[:number], replace(step, ranked=kept), *found.steps[number + 1 :])
    score = trial.score(trial.dispersion, trial.fit.dof)
    return replace(found, final=trial, steps=(*steps, Step(found.final, trial, ((trial, score),))))
