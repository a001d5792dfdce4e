"""The diagnosis document: verdict, residuals, findings; JSON by the contract.

Data only. How a verdict is reached is in ``invid.diagnosis``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, asdict, dataclass, field, fields
from enum import StrEnum
from pathlib import Path
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError

from invid.errors import InputError
from invid.model.document import FORMAT as MODEL_FORMAT
from invid.model.document import (
    EffectTerm,
    Estimate,
    Model,
    describe_validation_error,
    dump_json,
    effect_from_json,
    effect_to_json,
    load_json,
    model_from_json,
    model_to_json,
    save_text,
)
from invid.model.named_change import NamedChange

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
    noise_floor: float | None
    """What the sensors' noise alone would leave; ``None`` where the record does not show it."""

    @property
    def floor(self) -> float:
        """What an axis is compared with: its noise floor, else what is left, which then repeats."""
        return self.after if self.noise_floor is None else self.noise_floor


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


SURE = 0.9
"""Confidence from which a cause is named without reserve: a contested one has at most 0.89 (the contract)."""


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

    @property
    def cause(self) -> str:
        """Name of the cause, as in docs/reference/causes.md."""
        return self.effect.cause

    @property
    def is_doubtful(self) -> bool:
        """Whether the cause may be another one: nobody is to repair anything for it yet."""
        return bool(self.alternatives) or self.confidence < SURE

    @property
    def axis(self) -> str:
        """The axis at which the cause acts."""
        return self.effect.axis

    @property
    def element(self) -> str | None:
        """ "mass q" or "spring s" of the axis, from the motor and from 1; ``None`` where none is meant."""
        return self.effect.element

    @property
    def other_axis(self) -> str | None:
        """The second axis of a cause between two."""
        return self.effect.other_axis

    @property
    def parameters(self) -> Mapping[str, Estimate]:
        """Sizes by name: ``.value``, ``.std`` (one standard deviation) and ``.unit``, SI."""
        return self.effect.parameters


@dataclass(frozen=True)
class Unexplained:
    """Where and how the part lives that no cause of the catalogue explains."""

    axis: str
    frequencies_hz: tuple[float, ...]
    character: tuple[str, ...]
    """Any of odd, even, amplitude-, position-, velocity-, time-dependent."""
    sentence: str


@dataclass(frozen=True)
class RuledOut:
    """The smallest size of a cause at a place that the recording would have shown with 95 % probability.

    ``limit`` is that of ``parameter``; ``None`` where it could not have been seen, and ``why`` says so. Of a
    gain it is the distance from one, of Stribeck and asymmetric friction what they have beyond dry friction;
    a ``mass`` of a base or a ``limit`` of a torque shows below it. ``at``: other parameters of the law
    (cycles, phase, frequency, knee) where it shows least; the limit is for those.
    """

    cause: str
    axis: str
    element: str | None
    other_axis: str | None
    parameter: str
    limit: float | None
    unit: str | None
    why: str | None
    sentence: str = ""
    at: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ForceAt:
    """Rms force at a place that is in no law of the model [N·m or N], without and with the named causes.

    ``element`` and ``other_axis`` as in findings; between two loads the element is that of ``axis``.
    """

    axis: str
    element: str
    other_axis: str | None
    unit: str
    before: float
    after: float


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
    """What changed, does it matter, where, what now, for the person beside the robot; in a sentence."""
    changes: tuple[NamedChange, ...] | None = None
    """What changed since the accepted model; ``None`` where nothing was compared."""
    ruled_out: tuple[RuledOut, ...] = ()
    """What the recording would have shown, by cause and place; empty where the verdict is unexplained."""
    forces: tuple[ForceAt, ...] = ()
    """What acts at each place and is in no law, elastic machines alone; most is left where ``after`` is
    largest."""
    against: Mapping[str, Any] | None = None
    """What a user's own simulator gets wrong here (docs/how-to/against.md)."""

    @property
    def grade(self) -> Grade | None:
        """The most serious of findings and changes; ``None`` where something is there that has no name."""
        if self.verdict is Verdict.UNEXPLAINED or not self.model.fit.get("trustworthy", True):
            return None
        grades = [f.consequence.grade for f in self.findings if f.consequence is not None]
        # A new state of the robot has no figure to be judged by.
        grades += [Grade.WATCH for c in self.changes or () if c.matters]
        return min(grades, key=lambda g: g.rank, default=Grade.AS_EXPECTED)

    def save(self, path: str | Path) -> None:
        """Write the ``invid-diagnosis`` file; InputError where that cannot be."""
        save_text(Path(path), dump_json(diagnosis_to_json(self)))


def diagnosis_to_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """The contract's ``invid-diagnosis`` document."""

    def finding(f: Finding) -> dict[str, Any]:
        return {
            **effect_to_json(f.effect),
            "confidence": f.confidence,
            "gain": {"held_out": {"before": f.before, "after": f.after}, "fraction": f.fraction},
            "alternatives": [asdict(a) for a in f.alternatives],
            "separating_experiment": None
            if f.separating_experiment is None
            else dict(f.separating_experiment),
            "sentence": f.sentence,
            "consequence": None if f.consequence is None else asdict(f.consequence),
        }

    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "verdict": str(diagnosis.verdict),
        "headline": diagnosis.headline,
        "grade": None if diagnosis.grade is None else str(diagnosis.grade),
        "residual": [asdict(r) for r in diagnosis.residual],
        "explained_fraction": diagnosis.explained_fraction,
        "findings": [finding(f) for f in diagnosis.findings],
        "unexplained": None if diagnosis.unexplained is None else asdict(diagnosis.unexplained),
        "model": model_to_json(diagnosis.model),
        "warnings": list(diagnosis.warnings),
        "sentences": list(diagnosis.sentences),
        "forces": [asdict(f) for f in diagnosis.forces],
        "ruled_out": [asdict(r) for r in diagnosis.ruled_out],
        "changes": None if diagnosis.changes is None else [asdict(c) for c in diagnosis.changes],
        "details": dict(diagnosis.details),
        **({} if diagnosis.against is None else {"against": dict(diagnosis.against)}),
    }


def diagnosis_from_json(document: Any, *, source: str = "diagnosis") -> Diagnosis:
    """Diagnosis from a parsed ``invid-diagnosis`` document; InputError says what is wrong and where."""
    if not isinstance(document, Mapping) or document.get("format") != FORMAT:
        found = document.get("format") if isinstance(document, Mapping) else type(document).__name__
        raise InputError(f"{source}: no diagnosis: format is {found!r}, not {FORMAT!r}")
    if document.get("format_version") != FORMAT_VERSION:
        raise InputError(
            f"{source}: format_version {document.get('format_version')!r}; readable is {FORMAT_VERSION}"
        )
    hints = get_type_hints(Diagnosis)
    values: dict[str, Any] = {"model": model_from_json(document.get("model"), source=f"{source}: model")}
    for f in fields(Diagnosis):
        if f.name == "model" or f.name not in document:
            continue
        given = document[f.name]
        if f.name == "findings" and isinstance(given, list | tuple):
            given = [_finding(g, f"{source}: findings") if isinstance(g, Mapping) else g for g in given]
        try:
            values[f.name] = TypeAdapter(hints[f.name]).validate_python(given)
        except ValidationError as error:
            raise InputError(describe_validation_error(error, f"{source}: {f.name}")) from None
    missing = [f.name for f in fields(Diagnosis) if f.name not in values and _is_required(f)]
    if missing:
        raise InputError(f"{source}: {missing[0]} is missing")
    return Diagnosis(**values)


def _is_required(f: Field[Any]) -> bool:
    return f.default is MISSING and f.default_factory is MISSING


def _finding(document: Mapping[str, Any], source: str) -> dict[str, Any]:
    """The fields of a ``Finding``, which the document holds less deeply."""
    place = {k: document.get(k) for k in ("cause", "axis", "element", "other_axis", "parameters")}
    gain = document.get("gain") or {}
    held_out = gain.get("held_out") or {}
    sizes = {
        "before": held_out.get("before"),
        "after": held_out.get("after"),
        "fraction": gain.get("fraction"),
    }
    return {**document, "effect": effect_from_json(place, source=source), **sizes}


def document_from_json(document: Any, *, source: str = "document") -> Model | Diagnosis:
    """Model or diagnosis, whichever the parsed document says that it is; InputError names what else it is."""
    found = document.get("format") if isinstance(document, Mapping) else None
    if found == FORMAT:
        return diagnosis_from_json(document, source=source)
    if found == MODEL_FORMAT:
        return model_from_json(document, source=source)
    what = f"format is {found!r}" if found is not None else "it names no format"
    raise InputError(f"{source}: neither a model nor a diagnosis: {what}, not {MODEL_FORMAT!r} or {FORMAT!r}")


def load_document(path: str | Path) -> Model | Diagnosis:
    """Model or diagnosis from a file."""
    return document_from_json(load_json(Path(path)), source=str(path))


def load_model(path: str | Path) -> Model:
    """Model from a file of it, or from a diagnosis: the extended one."""
    return model_of(load_document(path))


def load_diagnosis(path: str | Path) -> Diagnosis:
    """Diagnosis from a file; InputError where it is none, a model say."""
    return diagnosis_from_json(load_json(Path(path)), source=str(path))


def model_of(document: Model | Diagnosis) -> Model:
    """The model itself, or the extended one of a diagnosis."""
    return document.model if isinstance(document, Diagnosis) else document
