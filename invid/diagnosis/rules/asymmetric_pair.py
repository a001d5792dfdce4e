"""Rule: a constant torque and dry friction on one axis, against friction that differs by direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from invid.diagnosis.evidence import evidence_if_finite
from invid.diagnosis.rules.near_variants import extended_schwarz_penalty
from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import COMPETES
from invid.effects.effect import Effect
from invid.effects.laws.sign import DryLaw
from invid.effects.registry import BY_CAUSE
from invid.likelihood.joint_fit import fit
from invid.likelihood.placed_effect import PlacedEffect
from invid.numerics.arrays import Float64
from invid.signals.spectral_record import SpectralRecord

PARTS = ("torque_offset", "coulomb_friction", "viscous_friction")


def doubt_asymmetric_pairs(
    found: Selection, train: Sequence[SpectralRecord], held: Sequence[SpectralRecord]
) -> Selection:
    """The selection with asymmetric friction as rival of such pairs, as far as the data do not tell them
    apart.

    The pair is that cause with the same viscous friction both ways, or with none. Without the rule the pair
    left nothing but noise of an asymmetric friction at 6 dB, and each part was certain.
    """
    known = len(found.base.fit.candidate.terms)
    final, terms = found.final, found.final.fit.candidate.terms
    for dry in terms[known:]:
        if dry.effect.cause != "coulomb_friction":
            continue
        parts = [
            k for k, t in enumerate(terms) if k >= known and t.effect.cause in PARTS and _is_part_of(t, dry)
        ]
        size = {terms[k].effect.cause: final.fit.candidate.x[k] for k in parts}
        if "torque_offset" not in size:
            continue
        start = _start_sizes(size["coulomb_friction"], size["torque_offset"], size.get("viscous_friction"))
        whole = PlacedEffect(_asymmetric_law_like(dry.effect), dry.place)
        kept = final.fit.candidate.only(k for k in range(len(terms)) if k not in parts)
        candidate = kept.plus(whole, start)
        trial = evidence_if_finite(
            partial(fit, final.fit.layout, train, final.fit.p, candidate, iterations=20), held
        )
        if trial is None:
            continue
        rows = found.base.fit.dof
        score_gap = trial.score(final.dispersion, rows) - final.score(final.dispersion, rows)
        score_gap -= extended_schwarz_penalty(final.fit.layout.structure)
        if score_gap >= COMPETES and trial.cost - final.cost >= final.beyond_noise:
            continue
        steps = list(found.steps)
        for k in parts:
            step = steps[k - known]
            others = replace(
                step, ranked=tuple(r for r in step.ranked if not _is_same_cause(r[0].term, whole))
            )
            steps[k - known] = others.with_rivals([(trial, step.ranked[0][1] + max(score_gap, 0.0))])
        found = replace(found, steps=tuple(steps))
    return found


def _is_part_of(part: PlacedEffect, dry: PlacedEffect) -> bool:
    """Whether a cause may be a part of one friction with ``dry``; a constant torque anywhere on the axis
    may."""
    return part.place == dry.place or (
        part.effect.cause == "torque_offset" and part.place.axis == dry.place.axis
    )


def _is_same_cause(one: PlacedEffect, other: PlacedEffect) -> bool:
    return one.effect.cause == other.effect.cause and one.place == other.place


def _asymmetric_law_like(dry: Effect) -> Effect:
    """Asymmetric friction whose sign changes over the same range of velocity as that of ``dry``."""
    law = BY_CAUSE["asymmetric_friction"]
    if isinstance(dry, DryLaw) and isinstance(law, DryLaw) and dry.rounding > 0:
        return law.rounded(dry.rounding)
    return law


def _start_sizes(dry: Float64, constant: Float64, wet: Float64 | None) -> Float64:
    """(4,) sizes of the asymmetric friction that the parts add up to."""
    viscous = 0.0 if wet is None else float(wet[0])
    both = float(dry[0]) + np.array([1.0, -1.0]) * float(constant[0])
    return np.concatenate((np.maximum(both, 0.0), [viscous, viscous]))


__all__ = ["doubt_asymmetric_pairs"]
