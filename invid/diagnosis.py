"""The diagnosis document: verdict, residuals, findings; JSON by the contract.

Data only. How a verdict is reached is in ``invid.discrepancy``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from invid.model import EffectTerm, Estimate, Model, effect_to_json, model_to_json

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


class Grade(StrEnum):
    """What a finding means for the robot."""

    AS_EXPECTED = "as_expected"
    """Within what is given for this robot, or usual for such drives: nothing to do."""
    WATCH = "watch"
    """More than usual, or nothing is known to judge it by: compare it with the next measurement."""
    ACT = "act"
    """Beyond the limit: look at the machine."""

    @property
    def rank(self) -> int:
        """0 for the most serious."""
        return (Grade.ACT, Grade.WATCH, Grade.AS_EXPECTED).index(self)


@dataclass(frozen=True)
class Consequence:
    """What one finding means: its grade, by which figure, and its size as a person would state it.

    ``measures`` are the sizes by name (``docs/reference/causes.md``), in SI units or as fractions;
    ``source`` names the publication, the config or nothing.
    """

    grade: Grade
    text: str
    reason: str
    share_of_rated_torque: float | None = None
    source: str | None = None
    measures: Mapping[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "grade": str(self.grade),
            "share_of_rated_torque": self.share_of_rated_torque,
            "text": self.text,
            "reason": self.reason,
            "source": self.source,
            "measures": dict(self.measures),
        }


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
    consequence: Consequence | None = None


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
    headline: str = ""
    """One sentence for the person beside the robot."""

    @property
    def grade(self) -> Grade | None:
        """The most serious of the findings; ``None`` where something is there that has no name."""
        if self.verdict is Verdict.UNEXPLAINED or not self.model.fit.get("trustworthy", True):
            return None
        grades = [f.consequence.grade for f in self.findings if f.consequence is not None]
        return min(grades, key=lambda g: g.rank, default=Grade.AS_EXPECTED)


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
            "consequence": None if f.consequence is None else f.consequence.to_json(),
        }

    unexplained = diagnosis.unexplained
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "verdict": str(diagnosis.verdict),
        "headline": diagnosis.headline,
        "grade": None if diagnosis.grade is None else str(diagnosis.grade),
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
    "Consequence",
    "Diagnosis",
    "EffectTerm",
    "Estimate",
    "Finding",
    "Grade",
    "Unexplained",
    "Verdict",
    "diagnosis_to_json",
]
