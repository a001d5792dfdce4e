"""The diagnosis document: verdict, residuals, findings; JSON by the contract.

Data only. How a verdict is reached is in ``invid.diagnosis``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from invid.model.document import EffectTerm, Estimate, Model, effect_to_json, model_to_json

FORMAT = "invid-diagnosis"
FORMAT_VERSION = 1


class Verdict(StrEnum):
    """What the data say about the model."""

    CONSISTENT = "consistent"
    EXPLAINED = "explained"
    PARTLY_EXPLAINED = "partly_explained"
    UNEXPLAINED = "unexplained"


@dataclass(frozen=True)
class AxisResidual:
    """Held-out missing torque of one axis, rms over the informative band [N·m or N]."""

    axis: str
    unit: str
    before: float
    after: float
    noise_floor: float


@dataclass(frozen=True)
class Alternative:
    """A cause that competes with the finding; ``after`` is its held-out residual."""

    cause: str
    axis: str
    element: str | None
    after: float
    other_axis: str | None = None


@dataclass(frozen=True)
class Finding:
    """A named cause at its place, with its held-out gain."""

    effect: EffectTerm
    confidence: float
    before: float
    after: float
    fraction: float
    alternatives: tuple[Alternative, ...] = ()
    separating_experiment: Mapping[str, Any] | None = None
    sentence: str = ""


@dataclass(frozen=True)
class Unexplained:
    """Where and how the part lives that no cause of the catalogue explains."""

    axis: str
    frequencies_hz: tuple[float, ...]
    character: tuple[str, ...]
    """Any of odd, even, amplitude-, position-, velocity-, time-dependent."""
    sentence: str


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What the simulation gets wrong, the cause, the extended model, the gain."""

    verdict: Verdict
    residual: tuple[AxisResidual, ...]
    explained_fraction: float | None
    findings: tuple[Finding, ...]
    unexplained: Unexplained | None
    model: Model
    """The extended model."""
    warnings: tuple[str, ...] = ()
    sentences: tuple[str, ...] = ()
    """What a technician can act on, most important first."""
    details: Mapping[str, Any] = field(default_factory=dict)
    """Further facts: null test (chi2, dof, p), causes the record could not have shown, …"""


def diagnosis_to_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """The contract's ``invid-diagnosis`` document."""

    def finding(f: Finding) -> dict[str, Any]:
        return {
            **effect_to_json(f.effect),
            "confidence": f.confidence,
            "gain": {"held_out": {"before": f.before, "after": f.after}, "fraction": f.fraction},
            "alternatives": [
                {
                    "cause": a.cause,
                    "axis": a.axis,
                    "element": a.element,
                    "other_axis": a.other_axis,
                    "after": a.after,
                }
                for a in f.alternatives
            ],
            "separating_experiment": None
            if f.separating_experiment is None
            else dict(f.separating_experiment),
            "sentence": f.sentence,
        }

    unexplained = diagnosis.unexplained
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "verdict": str(diagnosis.verdict),
        "residual": [
            {
                "axis": r.axis,
                "unit": r.unit,
                "before": r.before,
                "after": r.after,
                "noise_floor": r.noise_floor,
            }
            for r in diagnosis.residual
        ],
        "explained_fraction": diagnosis.explained_fraction,
        "findings": [finding(f) for f in diagnosis.findings],
        "unexplained": None
        if unexplained is None
        else {
            "axis": unexplained.axis,
            "frequencies_hz": list(unexplained.frequencies_hz),
            "character": list(unexplained.character),
            "sentence": unexplained.sentence,
        },
        "model": model_to_json(diagnosis.model),
        "warnings": list(diagnosis.warnings),
        "sentences": list(diagnosis.sentences),
        "details": dict(diagnosis.details),
    }


__all__ = [
    "Alternative",
    "AxisResidual",
    "Diagnosis",
    "EffectTerm",
    "Estimate",
    "Finding",
    "Unexplained",
    "Verdict",
    "diagnosis_to_json",
]
