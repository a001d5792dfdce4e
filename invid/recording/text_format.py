"""How a text file is written: its encoding, the sign of the decimals, and the one between thousands."""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from charset_normalizer import from_bytes

from invid.errors import InputError
from invid.numerics.arrays import Float64

_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16",
}  # fmt: skip
"""Longer marks first where one begins like another."""
SMOOTHER = 2.0
"""How much less numbers must leap with thousands before these are thought of: 998 and 1.002 leap by
a thousand."""
_SAMPLE = 200_000
_CANDIDATES = ["cp1252", "cp1250", "cp1251", "shift_jis", "gb18030", "utf_16_le", "utf_16_be"]
_SPACES = " \u00a0\u2009\u202f"
NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eEdD][+-]?\d+)?$")
_GROUPED = re.compile(
    rf"[+-]?\d{{1,3}}(?:(?P<group>[.,'’{_SPACES}])\d{{3}})(?:(?P=group)\d{{3}})*(?:(?P<sign>[.,])\d+)?$"
)


@dataclass(frozen=True)
class NumberFormat:
    """``thousands`` is None where numbers are written without."""

    decimal: str = "."
    thousands: str | None = None

    def number(self, cell: str) -> float:
        """The number in a cell; NaN where it holds none."""
        if self.thousands is not None and any(c in cell for c in _same(self.thousands)):
            grouped = _GROUPED.match(cell)
            if grouped is None or grouped["group"] not in _same(self.thousands):
                return math.nan
            cell = cell.replace(grouped["group"], "")
        if self.decimal == ",":
            cell = cell.replace(",", ".")
        try:
            return math.nan if "_" in cell else float(cell)
        except ValueError:
            pass
        if cell and cell[-1].isdigit() and ("D" in cell or "d" in cell) and NUMBER.match(cell):
            # Fortran's double precision.
            return float(re.sub("[dD]", "e", cell))
        return math.nan


def _same(thousands: str) -> str:
    return _SPACES if thousands in _SPACES else "'’" if thousands in "'’" else thousands


def is_numeral(cell: str) -> bool:
    """Return whether a cell is a number in some way of writing."""
    return bool(NUMBER.match(cell)) or _plainly_grouped(cell) is not None


def _plainly_grouped(cell: str) -> NumberFormat | None:
    """The format of a cell that can only have thousands: two groups, or decimals of another sign."""
    found = _GROUPED.match(cell)
    if found is None or found["group"] == found["sign"]:
        return None
    group, sign = found["group"], found["sign"]
    if sign is None and group in ".," and cell.count(group) < 2:
        return None
    return NumberFormat(sign or ("." if group != "." else ","), group)


def find_number_format(
    columns: Iterable[Sequence[str]], decimal: str | None, thousands: str | None, where: str
) -> NumberFormat:
    """The format of cells by column; ``decimal`` and ``thousands`` as far as the map gives them.

    Raises
    ------
    InputError
        Signs that may stand for decimals as well as between thousands.
    """
    columns = [list(c) for c in columns]
    cells = [c for column in columns for c in column]
    plain = [f for c in cells if (f := _plainly_grouped(c)) is not None]
    plain = [f for f in plain if decimal in (None, f.decimal) and thousands in (None, f.thousands)]
    if plain and thousands is None:
        first = plain[0]
        thousands = first.thousands
        # Of "1,234,567" nobody sees the decimals; what other cells have decides.
        decimal = decimal or first.decimal
    if decimal is not None:
        return NumberFormat(decimal, thousands)
    if thousands is not None:
        return NumberFormat("," if thousands == "." else ".", thousands)
    numerals = [c for c in cells if NUMBER.match(c)]
    commas, points = sum("," in c for c in numerals), sum("." in c for c in numerals)
    sign = "," if commas > points else "."
    for column in columns:
        doubtful = _doubtful(column, sign)
        if doubtful is not None:
            other = "." if sign == "," else ","
            raise InputError(
                f"{where}: {doubtful!r} may be a number of three decimals or one of thousands; write "
                f"'thousands: {sign!r}' (decimals are then {other!r}) or 'decimal: {sign!r}' in the map's "
                f"'source'"
            )
    return NumberFormat(sign, None)


def _doubtful(column: Sequence[str], sign: str) -> str | None:
    """A cell of a column whose numbers with ``sign`` all have three digits after it, and whose values leap
    less with thousands than with decimals."""
    numerals = [c for c in column if NUMBER.match(c)]
    having = [c for c in numerals if sign in c]
    if not having or not all(re.match(rf"[+-]?[1-9]\d{{0,2}}{re.escape(sign)}\d{{3}}$", c) for c in having):
        return None
    as_decimals = np.array([NumberFormat(sign).number(c) for c in numerals])
    as_thousands = np.array([float(c.replace(sign, "")) if sign in c else float(c) for c in numerals])
    # Where all have the sign the one is a thousand times the other, and as smooth.
    return having[0] if _roughness(as_decimals) > SMOOTHER * _roughness(as_thousands) else None


def _roughness(values: Float64) -> float:
    """Mean square of a step over the variance."""
    spread = float(np.var(values))
    return float(np.mean(np.diff(values) ** 2)) / spread if spread > 0 else 0.0


def decode_text(raw: bytes, encoding: str | None, where: str) -> tuple[str, str]:
    """The text of ``raw`` and its encoding: the one given, by its mark, UTF-8, or what charset-normalizer
    finds.

    Raises
    ------
    InputError
        No text in the encoding given, or in any that is looked for.
    """
    if encoding is None:
        encoding = next((name for mark, name in _MARKS.items() if raw.startswith(mark)), None)
    for guess in [encoding] if encoding else ["utf-8", _likely(raw)]:
        try:
            text = raw.decode(guess)
        except (UnicodeDecodeError, LookupError):
            continue
        if "\0" not in text[:10_000]:
            return text.replace("\u2212", "-"), guess  # a minus as it is printed
    raise InputError(
        f"{where}: is no text that can be read as {encoding or 'UTF-8 or what else is usual'}; where it is "
        "text, name its 'encoding' in the map's 'source', else its 'kind'"
    )


def _likely(raw: bytes) -> str:
    head = raw[:_SAMPLE]
    if head.count(0) > len(head) // 8:
        # A zero in every other byte: UTF-16 of letters that ASCII has, without its mark.
        return "utf_16_be" if head[::2].count(0) > head[1::2].count(0) else "utf_16_le"
    if re.search(rb"[\x80-\xff]{2}", head) is None:
        return "cp1252"  # [µs] and [°] alone: what needs two bytes a letter has them in words
    # Few letters beyond ASCII tell hardly anything; where several fit alike the first, the commonest, is
    # taken.
    best = from_bytes(head, cp_isolation=_CANDIDATES).best()
    return best.encoding if best is not None else "latin-1"


__all__ = ["NUMBER", "NumberFormat", "decode_text", "find_number_format", "is_numeral"]
