"""The page's own texts by key, in English in ``texts.json``; the core names causes and their numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from invid.clauses import cause_name, parameter_name
from invid.effects.registry import BY_CAUSE
from invid.wording.sentence import Figure, catalogue, say


@cache
def texts_of(language: str) -> Mapping[str, str]:
    """Return texts by key; KeyError for a language that is not there."""
    own = json.loads(Path(__file__).with_name("texts.json").read_text(encoding="utf-8"))
    names = {f"cause.{cause}": cause_name(cause) for cause in BY_CAUSE}
    names |= {f"effect.{n}": parameter_name(n) for e in BY_CAUSE.values() for n in e.parameters}
    said = {key: say(name, language) for key, name in {**names, "number.point": Figure(".")}.items()}
    return said | {key: catalogue(language).get(text, text) for key, text in own.items()}
