"""A second identification, with the causes taken out that the first did not know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from invid.diagnosis.known_effects import folded
from invid.diagnosis.linear_fit import LOWER, doubted
from invid.diagnosis.search_pass import Look, looked
from invid.diagnosis.time_domain_check import wave_of, with_torque
from invid.errors import InvidError
from invid.identification.identify import identify
from invid.likelihood.placed_effect import contributions, rattling
from invid.numerics.arrays import Float64
from invid.recording.model import Recording


def looked_again(look: Look, masses: Sequence[int] | Literal["auto"] | None) -> Look:
    """The look, or a better one through a model that was identified with its causes taken out.

    Strong friction leads the identification of a recording to a wrong number of masses, or to masses that no
    step leads back from, and what causes are found on such a model never reaches the noise. What they
    contribute is known well enough to take most of it out: the rest is a linear machine again.
    """
    final = look.selection.final
    known = look.selection.base.fit.candidate.terms
    if known or not look.selection.steps or not doubted(look.model, final):
        return look
    if rattling(final.fit.candidate) is not None:  # found from the lowest lines, whatever the first model was
        return look
    try:
        model = identify(without_causes(look), masses=masses)
    except InvidError:
        return look
    # What stands on its friction, and how much of it there is, is seen in the recording as it was.
    friction = {k: v for k, v in look.model.fit.items() if k == "friction"}
    other = looked(look.recording, folded(replace(model, fit={**model.fit, **friction})))
    # Both are of the same lines, and a wrong minimum is off by far more.
    return other if other.selection.final.cost < LOWER * final.cost else look


def without_causes(look: Look) -> Recording:
    """The recording with the torque that the linear machine alone would take, as far as causes are found."""
    known = {s.key: s for s in look.spectra}
    final = look.selection.final
    waves: dict[str, Float64] = {}
    for view in (*final.fit.evaluation.views, *final.held.views):
        record = view.record
        if record.key not in waves and not record.alone:
            taken = contributions(view, final.fit.candidate)
            waves[record.key] = -wave_of(taken, record, known[record.key])
    return with_torque(look.recording, look.spectra, waves)
