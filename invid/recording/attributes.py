"""HDF5 attributes as other programs write them, read into the contract's types.

MATLAB, LabVIEW, C and Python write the same thing in different ways: text as bytes or str, fixed or
variable length; numbers as scalars, one-element arrays, row or column vectors, any integer or float
type; lists as JSON text or as arrays. All of these are read alike; what cannot be is one sentence.
"""

from __future__ import annotations

import json
from enum import StrEnum
from typing import Annotated, Any, Literal, Self

import h5py
import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from invid.errors import RecordingError
from invid.numerics.arrays import Float64, frozen_float
from invid.recording.model import Kind, Outcome, Role


def _text(value: Any) -> str:
    value = value[0] if isinstance(value, list) and len(value) == 1 else value
    if not isinstance(value, str):
        raise ValueError
    return value


def _texts(value: Any) -> Any:
    if isinstance(value, list) and len(value) == 1 and str(value[0]).lstrip().startswith("["):
        value = value[0]
    return json.loads(value) if isinstance(value, str) else value


def _numbers(value: Any) -> Float64:
    array = np.asarray(json.loads(value) if isinstance(value, str) else value)
    if array.dtype == bool or (array.dtype.kind not in "iuf" and array.size):
        raise ValueError
    return frozen_float(np.ravel(array))


def _number(value: Any) -> float:
    (number,) = _numbers(value).tolist()
    return float(number)


def _wholes(value: Any) -> tuple[int, ...]:
    numbers = _numbers(value)
    if not np.array_equal(numbers, np.round(numbers)) or (np.abs(numbers) > 1e9).any():
        raise ValueError
    return tuple(int(n) for n in numbers)


def _whole(value: Any) -> int:
    (number,) = _wholes(value)
    return number


def _torque_unit(value: Any) -> str:
    # The dot of N·m is typed in several ways (U+00B7, U+22C5, '.', '*', a space, none).
    text = _text(value)
    compact = text.strip()
    for dot in "⋅•.* ·":
        compact = compact.replace(dot, "")
    return {"Nm": "N·m", "N": "N"}.get(compact, text)


def _needed(words: str) -> Any:
    """A field that must be what ``words`` say."""
    return Field(description=words)


def _one_of(kind: type[StrEnum]) -> Any:
    return _needed(f"one of {', '.join(repr(str(v)) for v in kind)}")


Text = Annotated[str, BeforeValidator(_text), _needed("a text")]
Texts = Annotated[
    tuple[str, ...], BeforeValidator(_texts), _needed('a list of texts, written as JSON: ["A1", "A2"]')
]
Number = Annotated[float, BeforeValidator(_number), _needed("one number")]
Whole = Annotated[int, BeforeValidator(_whole), _needed("one whole number")]
Wholes = Annotated[tuple[int, ...], BeforeValidator(_wholes), _needed("a list of whole numbers")]
Numbers = Annotated[Any, BeforeValidator(_numbers), _needed("a list of numbers")]


class Attributes(BaseModel):
    """Attributes of one HDF5 object by the contract; others are kept."""

    model_config = ConfigDict(extra="allow", arbitrary_types_allowed=True, frozen=True)

    @classmethod
    def of(cls, node: h5py.HLObject, where: str) -> Self:
        """Those of an HDF5 object; RecordingError names the first that is missing or wrong."""
        values: dict[str, Any] = {}
        for name in list(node.attrs.keys()):
            try:
                values[str(name)] = _plain(node.attrs[name])
            except (OSError, TypeError, ValueError, KeyError, RuntimeError):
                # An unreadable attribute matters only where the contract needs it; then it is "missing".
                continue
        fields = cls.model_fields
        # HDF5's null dataspace stands for an empty list where one is needed, else for nothing.
        given = {k: v for k, v in values.items() if v != [] or (k in fields and fields[k].is_required())}
        try:
            return cls.model_validate(given)
        except (ValidationError, TypeError, OverflowError) as error:
            if not isinstance(error, ValidationError):
                raise ValueError(str(error)) from None
            name = str(error.errors()[0]["loc"][0])
            if name not in given:
                said = f"attribute {name!r} is missing; the contract needs it"
            else:
                shown = repr(given[name])
                shown = shown if len(shown) <= 60 else shown[:57] + "…"
                said = f"attribute {name!r} is {shown}; it must be {fields[name].description}"
            raise RecordingError(f"{where}: {said}") from None

    @property
    def rest(self) -> dict[str, Any]:
        """The attributes the contract does not name, as plain Python values where they can be."""
        return {k: v for k, v in (self.model_extra or {}).items() if _is_plain(v)}


class RootAttributes(Attributes):
    """Of a recording."""

    format: Annotated[Literal["invid-recording"], BeforeValidator(_text), _needed("'invid-recording'")]
    format_version: Annotated[Literal[1], BeforeValidator(_whole), _needed("1, which this invid reads")]
    axes: Texts
    robot: Text
    created: Text
    position_unit: Text
    torque_unit: Annotated[str, BeforeValidator(_torque_unit), _needed("a text")]
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


def _decoded(raw: bytes) -> str:
    """Text of a fixed-length string: UTF-8 by the contract, Latin-1 from older writers."""
    raw = raw.rstrip(b"\0")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _plain(value: Any) -> Any:
    """Plain Python values of what HDF5 holds; a null dataspace is an empty list."""
    if isinstance(value, h5py.Empty):
        return []
    if isinstance(value, bytes):
        return _decoded(value)
    if isinstance(value, str):
        # h5py keeps undecodable bytes of a text as surrogates; they came from a Latin-1 writer.
        return _decoded(value.encode("utf-8", "surrogateescape"))
    if isinstance(value, np.ndarray):
        return _plain(value.item()) if value.ndim == 0 else [_plain(v) for v in value.ravel()]
    return _plain(value.item()) if isinstance(value, np.generic) else value


def _is_plain(value: Any) -> bool:
    return all(map(_is_plain, value)) if isinstance(value, list) else isinstance(value, str | int | float)
