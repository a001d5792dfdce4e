"""Rule: the range of velocity over which friction changes its sign, chosen beside the causes found since.

The rounding of a law is no parameter of the fit. It is chosen by the linearised fit (as the widths of the
identification in ``invid.likelihood.nuisance.gradual_reversals``) and confirmed by a refit.
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
"""Roundings tried, over the rms velocity. Physical: below the first a jump is as good, above the last the law
is viscous friction that saturates."""
HALVINGS = 3
ROUNDS = 2
"""Passes over all laws: the width of one friction changes that of the next a little."""
ITERATIONS = 10


def fit_sign_widths(
    found: Selection, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> Selection:
    """The selection with the width of reversal of every motor's friction fitted.

    Unchanged where the null test accepts it, or where no width earns Schwarz' penalty of one parameter.
    """
    final = found.final
    for _ in range(ROUNDS):
        before = final
        for number in _dry_laws(final.fit):
            final = _tune_width(final, number, train, held)
        if final is before or not final.rejects([*train, *held]):
            break
    if final is found.final:
        return found
    last = found.steps[-1]
    rivals = last.ranked[1:]
    score = final.score(final.dispersion, final.fit.dof)
    chosen = Step(last.before, final, ((final, min([score, *(s for _, s in last.ranked[:1])])), *rivals))
    return replace(found, final=final, steps=(*found.steps[:-1], chosen))


def _dry_laws(found: JointFit) -> list[int]:
    """Numbers of the laws at motors that depend on the sign of the velocity."""
    return [
        k
        for k, t in enumerate(found.candidate.terms)
        if isinstance(t.effect, DryLaw) and t.place.kind == "mass" and t.place.number == 1
    ]


def _tune_width(
    trial: CandidateEvidence, number: int, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> CandidateEvidence:
    """The trial with the best width of one law, where a refit earns its penalty and improves held-out
    records."""
    here, penalty = trial.fit, float(np.log(max(trial.fit.dof, 2)))
    width, gain = _best_width(here, number)
    if width is None or gain < penalty * here.dispersion:
        return trial
    terms, law = here.candidate.terms, here.candidate.terms[number]
    assert isinstance(law.effect, DryLaw)  # noqa: S101 - by _dry
    other = PlacedEffect(law.effect.rounded(width), law.place)
    candidate = Candidate((*terms[:number], other, *terms[number + 1 :]), here.candidate.x)
    found = evidence_if_finite(
        partial(fit, here.layout, train, here.p, candidate, iterations=ITERATIONS), held
    )
    if found is None or (here.cost - found.fit.cost) / found.fit.dispersion < penalty:
        return trial
    return found if found.held.cost < trial.held.cost else trial


def _best_width(here: JointFit, number: int) -> tuple[float | None, float]:
    """The best width of a law's sign and the χ² it gains; ``None`` where the law has no width."""
    term, x = here.candidate.terms[number], here.candidate.x[number]
    law, screen = term.effect, Screen(here)
    if not isinstance(law, DryLaw):
        return None, 0.0
    pattern = term.place.pattern(here.layout.structure)
    speed = rms([v.velocity(pattern) for v in screen.views])
    shape = x[len(law.coefficients) :].tolist()

    def gain(width: float) -> float:
        """Gain of χ² with the columns of another width beside the present ones, which are projected out."""
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
