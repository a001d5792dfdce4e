"""Where a record does not show what its sensors' noise alone would leave, nothing is certain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from invid.diagnosis.selection import Selection
from invid.diagnosis.thresholds import UNSIZED
from invid.likelihood.null_test import scatter_share
from invid.model.diagnosis_document import Diagnosis
from invid.recording.model import Experiment, Kind, Recording

MOST_SCATTER = 0.5
"""Share of a floor's power that scatter between periods may have: beyond, the floor is no longer the sensors'
(by the contract scatter is a finding, never a floor)."""
LEAST_CHI2, LEAST_DOF = 0.3, 100
"""χ²/ν below which a noise is overstated, and the rows to tell it (statistical: by chance five standard
deviations below one; rounding that lies on odd lines alone may make it a half)."""
LEAST_LINES = 100
"""Excited lines of a single period that tell a cause from its rivals (empirical: from 48 lines of the case
study dry friction came out as Stribeck friction)."""


def doubt_floors(result: Diagnosis, selection: Selection, recording: Recording) -> Diagnosis:
    """The diagnosis without the floors that are not the sensors', and with what they make sure in doubt."""
    final = selection.final if result.findings else selection.base
    everywhere = ""
    if all(_is_short(e) for e in recording.experiments if e.kind is not Kind.CONSTANT_VELOCITY):
        everywhere = (
            f"the recording holds one period of fewer than {LEAST_LINES} lines: too little to tell a cause "
            "from its rivals and noise from what repeats; record more and longer periods"
        )
    elif final.dof >= LEAST_DOF and final.cost < LEAST_CHI2 * final.dof:
        everywhere = (
            f"less is left than the noise would leave (χ²/ν {final.cost / final.dof:.2g}): the noise is "
            "overstated, and what its sensors alone would leave is unknown"
        )
    axes = [r.axis for r in result.residual]
    scattering = [a for i, a in enumerate(axes) if scatter_share(final.held, i) > MOST_SCATTER]
    if everywhere:
        return _without_floors(result, axes, everywhere)
    if scattering:
        said = (
            f"{', '.join(scattering)}: the missing torque scatters from period to period by more than the "
            "sensors' noise, which is no floor: something acts that does not repeat; what is left is "
            "compared with it"
        )
        return _without_floors(result, scattering, said)
    return result


def _is_short(e: Experiment) -> bool:
    """Whether a periodic experiment holds less than two periods, of few lines."""
    return 0 < e.samples < 2 * e.period_samples and 0 < e.frequencies_hz.size < LEAST_LINES


def _without_floors(result: Diagnosis, axes: Sequence[str], said: str) -> Diagnosis:
    residual = tuple(replace(r, noise_floor=None) if r.axis in axes else r for r in result.residual)
    findings = tuple(
        replace(f, confidence=min(f.confidence, UNSIZED))
        if f.effect.axis in axes or f.effect.other_axis in axes
        else f
        for f in result.findings
    )
    return replace(result, residual=residual, findings=findings, warnings=(*result.warnings, said))
