"""The page's own texts by key; names of causes and of their numbers are those of the core."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from invid.clauses import cause_name, parameter_name
from invid.effects.registry import BY_CAUSE
from invid.wording.sentence import LANGUAGES, Figure, say

FOLDER = Path(__file__).parent / "static" / "texts"


@cache
def texts_of(language: str) -> Mapping[str, str]:
    """Return texts by key; KeyError for a language that is not there."""
    if language not in LANGUAGES:
        raise KeyError(language)
    own: Mapping[str, str] = json.loads((FOLDER / f"{language}.json").read_text(encoding="utf-8"))
    numbers = {p for effect in BY_CAUSE.values() for p in effect.parameters}
    names = {f"cause.{cause}": cause_name(cause) for cause in BY_CAUSE}
    names |= {f"effect.{n}": parameter_name(n) for n in numbers} | {"number.point": Figure(".")}
    return {**{key: say(name, language) for key, name in names.items()}, **own}
