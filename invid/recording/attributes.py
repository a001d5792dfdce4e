"""HDF5 attributes as other programs write them, read into the contract's types.

MATLAB, LabVIEW, C and Python write the same thing in different ways: text as bytes or str, fixed or
variable length; numbers as scalars, one-element arrays, row or column vectors, any integer or float
type; lists as JSON text or as arrays. All of these are read alike; what cannot be is one sentence.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np

from invid.errors import RecordingError
from invid.numerics.arrays import Float64, frozen_float

_TEXTS = 'a list of texts, written as JSON: ["A1", "A2"]'


class Attributes:
    """Typed access to the attributes of one HDF5 object; ``where`` names it in messages."""

    def __init__(self, values: Mapping[str, Any], where: str) -> None:
        self._values = values
        self._where = where

    def has(self, name: str) -> bool:
        """True where the attribute is there and not HDF5's null dataspace."""
        return name in self._values and not isinstance(self._values[name], h5py.Empty)

    def _get(self, name: str) -> Any:
        if name not in self._values:
            raise RecordingError(f"{self._where}: attribute {name!r} is missing; the contract needs it")
        return self._values[name]

    def text(self, name: str) -> str:
        """Return a string attribute."""
        value = _plain(self._get(name))
        if isinstance(value, list) and len(value) == 1:
            value = value[0]
        if not isinstance(value, str):
            raise self._wrong(name, value, "a text")
        return value

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a list of strings: JSON text, or an HDF5 array of strings."""
        value = _plain(self._get(name))
        if isinstance(value, list) and len(value) == 1 and _looks_like_json_list(value[0]):
            value = value[0]
        if isinstance(value, str):
            value = self._json(name, value, _TEXTS)
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise self._wrong(name, value, _TEXTS)
        return tuple(value)

    def number(self, name: str) -> float:
        """Return a real number."""
        return self._one(name, "one number")

    def whole(self, name: str) -> int:
        """Return a whole number."""
        value = self._one(name, "one whole number")
        if not np.isfinite(value) or value != int(value):
            raise self._wrong(name, value, "one whole number")
        return int(value)

    def _one(self, name: str, needed: str) -> float:
        values = self.numbers(name, needed)
        if values.size != 1:
            raise self._wrong(name, values.tolist(), needed)
        return float(values[0])

    def numbers(self, name: str, needed: str = "a list of numbers") -> Float64:
        """(n,) real numbers: scalar, any array (flattened), or JSON text; null dataspace is empty.

        ``needed`` says in words what the attribute must be.
        """
        value = self._get(name)
        if isinstance(value, h5py.Empty):
            return frozen_float(np.zeros(0))
        value = _plain(value)
        if isinstance(value, str):
            value = self._json(name, value, needed)
        try:
            array = np.asarray(value)
            if array.dtype == bool or (array.dtype.kind not in "iuf" and array.size):
                raise ValueError
            return frozen_float(np.ravel(array))
        except (ValueError, TypeError, OverflowError):
            raise self._wrong(name, value, needed) from None

    def rest(self, known: frozenset[str]) -> dict[str, Any]:
        """The attributes the contract does not name, as plain Python values where they can be."""
        return {k: _plain(v) for k, v in self._values.items() if k not in known and _is_plain(_plain(v))}

    def _json(self, name: str, text: str, needed: str) -> Any:
        try:
            return json.loads(text)
        except (json.JSONDecodeError, RecursionError):
            raise self._wrong(name, text, needed) from None

    def _wrong(self, name: str, value: Any, needed: str) -> RecordingError:
        shown = repr(value)
        shown = shown if len(shown) <= 60 else shown[:57] + "…"
        return RecordingError(f"{self._where}: attribute {name!r} is {shown}; it must be {needed}")


def read_attributes(node: h5py.HLObject, where: str) -> Attributes:
    """All attributes of an HDF5 object; one that HDF5 cannot decode is left out as if absent."""
    values: dict[str, Any] = {}
    for name in list(node.attrs.keys()):
        try:
            values[str(name)] = node.attrs[name]
        except (OSError, TypeError, ValueError, KeyError, RuntimeError):
            # An unreadable attribute matters only where the contract needs it; then it is "missing".
            continue
    return Attributes(values, where)


def decode(raw: bytes) -> str:
    """Text of a fixed-length string: UTF-8 by the contract, Latin-1 from older writers."""
    raw = raw.rstrip(b"\0")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _looks_like_json_list(value: Any) -> bool:
    return isinstance(value, str) and value.lstrip().startswith("[")


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return decode(value)
    if isinstance(value, str):
        # h5py keeps undecodable bytes of a text as surrogates; they came from a Latin-1 writer.
        return decode(value.encode("utf-8", "surrogateescape"))
    if isinstance(value, np.ndarray):
        return _plain(value.item()) if value.ndim == 0 else [_plain(v) for v in value.ravel()]
    if isinstance(value, np.generic):
        return _plain(value.item())
    return value


def _is_plain(value: Any) -> bool:
    if isinstance(value, list):
        return all(_is_plain(v) for v in value)
    return isinstance(value, (str, int, float, bool))
