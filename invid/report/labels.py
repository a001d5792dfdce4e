"""Texts that come from data, as they may stand in a picture or a page."""

from __future__ import annotations

import re

_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f\ud800-\udfff\ufffe\uffff]")


def printable(text: str, most: int = 200) -> str:
    """Text without characters that XML forbids, and not longer than a label can be."""
    clean = _CONTROL.sub("\N{REPLACEMENT CHARACTER}", text)
    return clean if len(clean) <= most else clean[: most - 1] + "…"


def label(text: str, most: int = 40) -> str:
    """A label inside a picture: one short line."""
    return printable(" ".join(text.split()) or "–", most)
