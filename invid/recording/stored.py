"""A recording as files hold it, whoever wrote them: attributes and datasets by the contract's names.

MATLAB, LabVIEW, C and Python write the same thing in different ways: text as bytes or str, fixed or
variable length; numbers as scalars, one-element arrays, row or column vectors, any integer or float
type; lists as JSON text or as arrays. All of these are read alike; what cannot be is one sentence.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from invid.errors import RecordingError
from invid.numerics.arrays import UInt16, frozen, frozen_float
from invid.recording.model import DATASETS, Experiment, Kind, Outcome, Recording, Role

FORMAT = "invid-recording"


def _text(value: Any) -> Any:
    return value[0] if isinstance(value, list) and len(value) == 1 else value


def _texts(value: Any) -> Any:
    text = _text(value)
    return json.loads(text) if isinstance(text, str) and text.lstrip().startswith("[") else value


def _numbers(value: Any) -> list[float]:
    array = np.asarray(json.loads(value) if isinstance(value, str) else value)
    if array.dtype.kind not in "iuf" and array.size:
        raise ValueError
    return list(np.ravel(array).tolist())


def _number(value: Any) -> float:
    (number,) = _numbers(value)
    return number


def _torque_unit(unit: str) -> str:
    # The dot of N·m is typed in several ways (U+00B7, U+22C5, '.', '*', a space, none).
    return {"Nm": "N·m", "N": "N"}.get(re.sub(r"[·⋅•.*\s]", "", unit), unit)


def _needed(words: str) -> Any:
    """A field that must be what ``words`` say."""
    return Field(description=words)


def _one_of(kind: type[StrEnum]) -> Any:
    return _needed(f"one of {', '.join(repr(str(v)) for v in kind)}")


_Int = Annotated[int, Field(ge=-1_000_000_000, le=1_000_000_000)]
Text = Annotated[str, BeforeValidator(_text), _needed("a text")]
Texts = Annotated[
    tuple[str, ...], BeforeValidator(_texts), _needed('a list of texts, written as JSON: ["A1", "A2"]')
]
Number = Annotated[float, BeforeValidator(_number), _needed("one number")]
Whole = Annotated[_Int, BeforeValidator(_number), _needed("one whole number")]
Wholes = Annotated[tuple[_Int, ...], BeforeValidator(_numbers), _needed("a list of whole numbers")]
Numbers = Annotated[
    Any, BeforeValidator(_numbers), AfterValidator(frozen_float), _needed("a list of numbers")
]


class Attributes(BaseModel):
    """Attributes of one object by the contract; others are kept."""

    model_config = ConfigDict(extra="allow", arbitrary_types_allowed=True, frozen=True)

    @classmethod
    def of(cls, values: Mapping[str, Any], where: str) -> Self:
        """Those of an object by plain Python values; RecordingError names the first that is missing or
        wrong.
        """
        fields = cls.model_fields
        # HDF5's null dataspace stands for an empty list where one is needed, else for nothing.
        given = {k: v for k, v in values.items() if v != [] or (k in fields and fields[k].is_required())}
        try:
            return cls.model_validate(given)
        except ValidationError as error:
            name = str(error.errors()[0]["loc"][0])
            said = f"attribute {name!r} is missing; the contract needs it"
            if name in given:
                shown = repr(given[name])
                shown = shown if len(shown) <= 60 else shown[:57] + "…"
                said = f"attribute {name!r} is {shown}; it must be {fields[name].description}"
            raise RecordingError(f"{where}: {said}") from None

    def fields(self) -> dict[str, Any]:
        """The contract's attributes, read; and as ``attributes`` the others, where they are plain values."""
        rest = {k: v for k, v in (self.model_extra or {}).items() if _is_plain(v)}
        own = {n: getattr(self, n) for n in type(self).model_fields if not n.startswith("format")}
        return {**own, "attributes": rest}


class RootAttributes(Attributes):
    """Of a recording."""

    format: Annotated[Literal["invid-recording"], BeforeValidator(_text), _needed("'invid-recording'")]
    format_version: Annotated[Literal[1], BeforeValidator(_number), _needed("1, which this invid reads")]
    axes: Texts
    robot: Text
    created: Text
    position_unit: Annotated[str, BeforeValidator(_text), AfterValidator(str.strip), _needed("a text")]
    torque_unit: Annotated[str, BeforeValidator(_text), AfterValidator(_torque_unit), _needed("a text")]
    masses_per_axis: Wholes | None = None
    rated_torque: Numbers = None
    encoder_resolution: Numbers = None
    config: Text | None = None
    outcome: Annotated[Outcome, BeforeValidator(_text), _one_of(Outcome)] | None = None


class ExperimentAttributes(Attributes):
    """Of one experiment."""

    hold_gain: Numbers
    excited_axis: Whole
    period_samples: Whole
    kind: Annotated[Kind, BeforeValidator(_text), _one_of(Kind)]
    role: Annotated[Role, BeforeValidator(_text), _one_of(Role)]
    frequencies_hz: Numbers
    sample_rate_hz: Number


def _is_plain(value: Any) -> bool:
    return all(map(_is_plain, value)) if isinstance(value, list) else isinstance(value, str | int | float)


@dataclass(frozen=True, eq=False)
class StoredExperiment:
    """Attributes and datasets of one experiment."""

    attributes: Mapping[str, Any]
    datasets: Mapping[str, npt.NDArray[Any]]


@dataclass(frozen=True, eq=False)
class StoredRecording:
    """Attributes of a recording, and its experiments by their keys."""

    attributes: Mapping[str, Any]
    experiments: Mapping[str, StoredExperiment]

    def read(self, source: str) -> Recording:
        """The recording, its values not yet checked.

        Raises
        ------
        RecordingError
            An attribute or a dataset that is missing, or is nothing that the contract knows.
        """
        root = RootAttributes.of(self.attributes, source).fields()
        experiments = [
            _experiment(key, e, f"{source}: experiment {key}", len(root["axes"]))
            for key, e in self.experiments.items()
        ]
        # A measurement cut off by a crash may leave its last experiment without rows: that is no fault.
        if root["outcome"] is not Outcome.COMPLETED and len(experiments) > 1 and experiments[-1].samples < 2:
            experiments.pop()
        return Recording(**root, experiments=tuple(experiments), source=source)


def _experiment(key: str, stored: StoredExperiment, where: str, axes: int) -> Experiment:
    fields = ExperimentAttributes.of(stored.attributes, where).fields()
    for name in ("time", "position", "torque"):
        if name not in stored.datasets:
            raise RecordingError(f"{where}: dataset {name!r} is missing; the contract needs it")
    if fields["hold_gain"].size == 1:
        fields["hold_gain"] = frozen_float(np.full(axes, fields["hold_gain"][0]))
    for name, values in stored.datasets.items():
        fields[name] = _statuswords(values, where) if name == "status" else np.asarray(values, np.float64)
        fields[name].setflags(write=False)
    return Experiment(key=key, **fields)


def _statuswords(values: npt.NDArray[Any], where: str) -> UInt16:
    if (
        values.dtype != np.uint16
        and not ((values >= 0) & (values <= 65535) & (values == values.round())).all()
    ):
        raise RecordingError(f"{where}: dataset 'status' holds values that are no 16-bit statuswords")
    return frozen(values, np.uint16)  # type: ignore[return-value]


def stored(recording: Recording) -> StoredRecording:
    """The recording as files hold it."""
    axes = json.dumps(list(recording.axes), ensure_ascii=False)
    attributes = {**recording.attributes, **_given(recording, RootAttributes), "axes": axes}
    attributes |= {"format": FORMAT, "format_version": 1}
    experiments = {
        e.key: StoredExperiment({**e.attributes, **_given(e, ExperimentAttributes)}, e.datasets())
        for e in recording.experiments
    }
    return StoredRecording(attributes, experiments)


def _given(holder: Recording | Experiment, kind: type[Attributes]) -> dict[str, Any]:
    """The contract's attributes that are given, enumerations as their texts."""
    found = {n: getattr(holder, n) for n in kind.model_fields if not n.startswith("format")}
    return {n: str(v) if isinstance(v, StrEnum) else v for n, v in found.items() if v is not None}


__all__ = [
    "DATASETS",
    "FORMAT",
    "ExperimentAttributes",
    "RootAttributes",
    "StoredExperiment",
    "StoredRecording",
    "stored",
]
