"""The texts of service and page: one flat JSON catalogue a language, a message is a key with values."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from invid.wording import statement as wording

FOLDER = Path(__file__).parent / "static" / "texts"
LANGUAGES = wording.LANGUAGES
"""The first is spoken where none of what a browser asks for is there."""
FAMILIES = ("cause.", "effect.", "measure.", "check.", "experiment.")
SHARED = ("number.point", "word.and", "word.or")
"""What the page says in the words of the core (``invid.wording``): names of causes and of their sizes."""


@cache
def catalogue(language: str) -> Mapping[str, str]:
    """Return texts by key; KeyError for a language that is not there."""
    if language not in LANGUAGES:
        raise KeyError(language)
    own: Mapping[str, str] = json.loads((FOLDER / f"{language}.json").read_text(encoding="utf-8"))
    shared = wording.catalogue(language)
    return {**{k: v for k, v in shared.items() if k in SHARED or k.startswith(FAMILIES)}, **own}


@cache
def sayings(language: str) -> Mapping[str, str]:
    """Return the sentences of core and service in a language by their English ones, with numbered gaps."""
    if language == wording.ENGLISH:
        return {}
    found: Mapping[str, str] = json.loads((FOLDER / f"said.{language}.json").read_text(encoding="utf-8"))
    return found


def said(key: str, values: Mapping[str, object] | None = None) -> str:
    """Return the English words of a key, for programs and logs; a page says them in its own language."""
    text = catalogue(wording.ENGLISH)[key]
    return text.format_map(values) if values else text


def told(key: str, **values: str) -> dict[str, Any]:
    """Return what is said under a key: its ``text``, the way out (``fix``), the ``values`` of its gaps."""
    return {"text": said(key, values), "fix": said(f"{key}.fix", values), "values": values}


def error_of(code: str, **values: str) -> dict[str, Any]:
    """Return why a run ended early, of which the service itself knows all."""
    return {"code": code, **told(f"error.{code}", **values)}


def drawing_words(language: str) -> dict[str, str]:
    """Return the words that ``invid.report.branch_drawing`` needs: ``drawing.*`` without its head, and the
    causes.
    """
    texts = catalogue(language)
    words = {k.removeprefix("drawing."): v for k, v in texts.items() if k.startswith("drawing.")}
    causes = {k: v for k, v in texts.items() if k.startswith("cause.")}
    return {**causes, **words, "point": texts["number.point"]}
