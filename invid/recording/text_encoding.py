"""The encoding of a text: its mark, UTF-8, or what charset-normalizer finds."""

from __future__ import annotations

import codecs
import re

from charset_normalizer import from_bytes

from invid.errors import InputError

_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16",
}  # fmt: skip
"""Longer marks first where one begins like another."""
_SAMPLE = 200_000
_CANDIDATES = ["cp1252", "cp1250", "cp1251", "shift_jis", "gb18030", "utf_16_le", "utf_16_be"]


def decode_text(raw: bytes, encoding: str | None, where: str) -> tuple[str, str]:
    """The text of ``raw`` and its encoding: the one given, else the one that is found.

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
            return text, guess
    raise InputError(
        f"{where}: is no text that can be read as {encoding or 'UTF-8 or what else is usual'}",
        way_out="where it is text, name its 'encoding' in the map's 'source', else its 'kind'",
        code="unknown_kind",
    )


def _likely(raw: bytes) -> str:
    head = raw[:_SAMPLE]
    if head.count(0) > len(head) // 8:
        # A zero in every other byte: UTF-16 of letters that ASCII has, without its mark.
        return "utf_16_be" if head[::2].count(0) > head[1::2].count(0) else "utf_16_le"
    if re.search(rb"[\x80-\xff]{2}", head) is None:
        return "cp1252"  # [µs] and [°] alone: what needs two bytes a letter has them in words
    # Few letters beyond ASCII tell hardly anything: of several that fit the first, the commonest, is taken.
    best = from_bytes(head, cp_isolation=_CANDIDATES).best()
    return best.encoding if best is not None else "latin-1"
