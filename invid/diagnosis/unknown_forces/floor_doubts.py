"""Where a record does not show what its sensors' noise alone would leave, nothing is certain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from invid.diagnosis.thresholds import UNSIZED
from invid.model.diagnosis_document import Diagnosis
from invid.recording.model import Experiment, Kind, Recording
from invid.recording.roll_off import low_passed_axes
from invid.wording.sentence import sentence

LEAST_LINES = 100
"""Excited lines of a single period that tell a cause from its rivals (empirical: from 48 lines of the case
study dry friction came out as Stribeck friction)."""


def doubt_floors(result: Diagnosis, recording: Recording) -> Diagnosis:
    """The diagnosis without the floors that are not the sensors', and with what they make sure in doubt."""
    shaken = [e for e in recording.experiments if e.kind is not Kind.CONSTANT_VELOCITY]
    if shaken and all(_is_short(e) for e in shaken):
        said = sentence(
            "the recording holds one period of fewer than {least_lines} lines: too little to "
            "tell a cause from its rivals and noise from what repeats; record more and longer "
            "periods",
            least_lines=LEAST_LINES,
        )
        return _without_floors(result, recording.axes, said)
    filtered = [recording.axes[m] for m in low_passed_axes(shaken)]
    if not filtered:
        return result
    said = sentence(
        "{names}: the torque went through a low-pass, so its noise above the excited band "
        "says nothing of the noise within: what is left is compared with what repeats; "
        "record the torque unfiltered",
        names=", ".join(filtered),
    )
    return _without_floors(result, filtered, said)


def _is_short(e: Experiment) -> bool:
    """Whether a periodic experiment holds less than two periods, of few lines."""
    return 0 < e.samples < 2 * e.period_samples and 0 < e.frequencies_hz.size < LEAST_LINES


def _without_floors(result: Diagnosis, axes: Sequence[str], said: str) -> Diagnosis:
    residual = tuple(replace(r, noise_floor=None) if r.axis in axes else r for r in result.residual)
    findings = tuple(
        replace(f, confidence=min(f.confidence, UNSIZED)) if {f.axis, f.effect.other_axis} & {*axes} else f
        for f in result.findings
    )
    return replace(result, residual=residual, findings=findings, warnings=(*result.warnings, said))
