"""Read the page's texts: one flat JSON catalogue a language, and which of them a request asks for."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from fastapi import Request

from invid.wording import statement as wording

FOLDER = Path(__file__).parent / "static" / "texts"
LANGUAGES = wording.LANGUAGES
"""The first is spoken where none of what a browser asks for is there."""
COOKIE = "invid-language"
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


def wanted(request: Request) -> str:
    """Return the language chosen on the page before, else the first of the browser's that is there."""
    chosen = request.cookies.get(COOKIE, "")
    return chosen if chosen in LANGUAGES else preferred(request.headers.get("accept-language", ""))


def preferred(header: str) -> str:
    """Return the best language of an ``Accept-Language`` header ("de-CH,de;q=0.9,en;q=0.8")."""
    ranked: list[tuple[float, int, str]] = []
    for place, part in enumerate(header.split(",")[:50]):
        tag, _, weight = part.strip().partition(";")
        try:
            share = float(weight.strip().removeprefix("q=")) if weight else 1.0
        except ValueError:
            continue
        language = tag.split("-")[0].strip().lower()
        if language in LANGUAGES and share > 0:
            ranked.append((-share, place, language))
    return min(ranked)[2] if ranked else LANGUAGES[0]


def drawing_words(language: str) -> dict[str, str]:
    """Return the words that ``invid.report.branch_drawing`` needs: ``drawing.*`` without its head, and the
    causes.
    """
    texts = catalogue(language)
    words = {k.removeprefix("drawing."): v for k, v in texts.items() if k.startswith("drawing.")}
    causes = {k: v for k, v in texts.items() if k.startswith("cause.")}
    return {**causes, **words, "point": texts["number.point"]}
