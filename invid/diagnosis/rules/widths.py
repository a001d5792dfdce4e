"""The range of velocity over which the friction found changes its sign, chosen beside what was found since.

The rounding of a law is no parameter of the fit. It is read from what the fit leaves, linear about where it
stands, as the widths of the identification are (``invid.likelihood.nuisance.gradual_reversals``), and earns
its place by a fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from invid.diagnosis.evidence import CandidateEvidence, Step, evidence_if_finite
from invid.diagnosis.score_test import Screen
from invid.diagnosis.selection import Selection
from invid.effects.laws.sign import DryLaw
from invid.effects.motion import rms
from invid.likelihood.joint_fit import JointFit, fit
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.signals.spectral_record import SpectralRecord

NARROWEST, WIDEST, WIDTHS = 2e-3, 0.3, 10
"""Roundings tried, as shares of the rms velocity: below the first the jump is as good, above the last the law
is viscous friction that saturates."""
HALVINGS = 3
ROUNDS = 2
"""How often all laws are gone through: the width of one friction moves that of the next a little."""
ITERATIONS = 10


def fit_sign_widths(
    found: Selection, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> Selection:
    """The selection with the width of reversal of every motor's friction fitted.

    As it came where what is left is noise, or where no width earns Schwarz' penalty of one parameter.
    """
    final = found.final
    for _ in range(ROUNDS):
        before = final
        for number in _dry(final.fit):
            final = _retuned(final, number, train, held)
        if final is before or not final.rejects([*train, *held]):
            break
    if final is found.final:
        return found
    last = found.steps[-1]
    rivals = last.ranked[1:]
    score = final.score(final.dispersion, final.fit.dof)
    chosen = Step(last.before, final, ((final, min([score, *(s for _, s in last.ranked[:1])])), *rivals))
    return replace(found, final=final, steps=(*found.steps[:-1], chosen))


def _dry(found: JointFit) -> list[int]:
    """Numbers of the laws at motors that change over with the sign of the velocity."""
    return [
        k
        for k, t in enumerate(found.candidate.terms)
        if isinstance(t.effect, DryLaw) and t.place.kind == "mass" and t.place.number == 1
    ]


def _retuned(
    trial: CandidateEvidence, number: int, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> CandidateEvidence:
    """The trial with the width of one law that leaves least, where it earns its place."""
    here, price = trial.fit, float(np.log(max(trial.fit.dof, 2)))
    width, gain = _best_width(here, number)
    if width is None or gain < price * here.dispersion:
        return trial
    terms, law = here.candidate.terms, here.candidate.terms[number]
    assert isinstance(law.effect, DryLaw)  # noqa: S101 - by _dry
    other = PlacedEffect(law.effect.rounded(width), law.place)
    candidate = Candidate((*terms[:number], other, *terms[number + 1 :]), here.candidate.x)
    found = evidence_if_finite(
        partial(fit, here.layout, train, here.p, candidate, iterations=ITERATIONS), held
    )
    if found is None or (here.cost - found.fit.cost) / found.fit.dispersion < price:
        return trial
    return found if found.held.cost < trial.held.cost else trial


def _best_width(here: JointFit, number: int) -> tuple[float | None, float]:
    """Width of a law's sign that leaves least, and the χ² that it takes; ``None`` where it is now's."""
    term, x = here.candidate.terms[number], here.candidate.x[number]
    law, screen = term.effect, Screen(here)
    if not isinstance(law, DryLaw):
        return None, 0.0
    pattern = term.place.pattern(here.layout.structure)
    speed = rms([v.velocity(pattern) for v in screen.views])
    shape = x[len(law.coefficients) :].tolist()

    def gain(width: float) -> float:
        """Of columns in place of now's, which the projection has taken out with all else that is fitted."""
        columns = screen.project([law.rounded(width).basis(v, term.place, shape) for v in screen.views])
        found, *_ = np.linalg.lstsq(columns, screen.residual, rcond=1e-9)
        return float(screen.residual @ screen.residual) - float(
            ((screen.residual - columns @ found) ** 2).sum()
        )

    widths = (speed * np.geomspace(NARROWEST, WIDEST, WIDTHS)).tolist()
    gains = [gain(w) for w in widths]
    best = int(np.argmax(gains))
    width, most = widths[best], gains[best]
    step = (WIDEST / NARROWEST) ** (0.5 / (WIDTHS - 1))
    for _ in range(HALVINGS):
        for near in (width * step, width / step):
            if (now := gain(near)) > most:
                width, most = near, now
                break
        step = step**0.5
    return width, most
