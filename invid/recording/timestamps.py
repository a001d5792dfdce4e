"""Instants as logs write them: dates with time, time of day; to seconds."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime

import numpy as np

from invid.numerics.arrays import Float64

_CLOCK = r"(?P<h>\d{1,2}):(?P<m>\d{2})(:(?P<s>\d{2})([.,](?P<f>\d{1,9}))?)?"
_DATE = (
    r"((?P<Y>\d{4})[-/.](?P<M>\d{1,2})[-/.](?P<D>\d{1,2})"
    r"|(?P<d1>\d{1,2})(?P<sep>[./])(?P<d2>\d{1,2})[./](?P<Y2>\d{4}))"
)
_ZONE = r"\s*(?P<z>Z|UTC|[+-]\d{2}:?\d{2})?"
_INSTANT = re.compile(rf"({_DATE}[T ]\s*)?{_CLOCK}{_ZONE}$|{_DATE.replace('?P<', '?P<o')}$")
DAY = 86400.0


def seconds_of(cell: str) -> float:
    """Seconds since 1970 of a date with time (or a date alone), since midnight of a time of day; NaN else.

    An instant without zone counts as UTC: only differences matter. 1.2.2026 is the first of February,
    1/2/2026 the second of January.
    """
    if ":" not in cell and cell.count(".") + cell.count("/") + cell.count("-") < 2:
        return math.nan
    found = _INSTANT.match(cell)
    if found is None:
        return math.nan
    part = found.groupdict()
    prefix = "o" if part["oY"] or part["oY2"] else ""
    clock = int(part["h"] or 0) * 3600.0 + int(part["m"] or 0) * 60.0 + int(part["s"] or 0)
    clock += float(f"0.{part['f']}") if part["f"] else 0.0
    if not (part[prefix + "Y"] or part[prefix + "Y2"]):
        return clock
    if part[prefix + "Y"]:
        year, month, day = (int(part[prefix + k]) for k in "YMD")
    else:
        first, second = int(part[prefix + "d1"]), int(part[prefix + "d2"])
        year = int(part[prefix + "Y2"])
        month, day = (first, second) if part[prefix + "sep"] == "/" and first <= 12 else (second, first)
    try:
        midnight = datetime(year, month, day, tzinfo=UTC).timestamp()
    except ValueError:
        return math.nan
    return midnight + clock - _zone(part["z"])


def _zone(text: str | None) -> float:
    if text is None or text in ("Z", "UTC"):
        return 0.0
    digits = text[1:].replace(":", "")
    return (-1.0 if text[0] == "-" else 1.0) * (int(digits[:2]) * 3600.0 + int(digits[2:]) * 60.0)


def past_midnight(seconds: Float64) -> Float64:
    """Times of day that go on after midnight instead of starting over."""
    known = np.isfinite(seconds)
    turned = np.diff(seconds[known], prepend=seconds[known][:1]) < -0.5 * DAY
    out = seconds.copy()
    out[known] += DAY * np.cumsum(turned)
    return out
