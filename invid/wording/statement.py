"""A typed statement, and the one place where it becomes a sentence of a language.

Whoever has something to say builds a ``Statement``: a code and its values. The words stand in ``en.json`` and
``de.json`` beside this module; ``say`` fills them in. No other module of the core, and no page, puts
sentences for people together in a language of its own.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Literal

LANGUAGES = ("en", "de")
"""The first one is that of documents and logs."""
ENGLISH = LANGUAGES[0]


@dataclass(frozen=True)
class Figure:
    """Numbers with their units as text, written with decimal points: "+1.31 ± 0.02 kg·m²"."""

    text: str


@dataclass(frozen=True)
class Listed:
    """Several values in one: "a, b and c"; titles that end alike share their last word."""

    items: tuple[Value, ...]
    by: Literal["and", "or", "comma", "semicolon", "titles"] = "and"


@dataclass(frozen=True)
class Clause:
    """The first clause of a sentence, to stand behind a colon: without its full stop."""

    of: Statement


@dataclass(frozen=True)
class Statement:
    """What is said: ``code`` names the words, ``values`` fill their gaps.

    ``english`` stands where a catalogue has no such code: the title of an effect that somebody added, say.
    """

    code: str
    values: Mapping[str, Value] = field(default_factory=dict)
    english: str = ""


Value = str | int | Figure | Listed | Clause | Statement


@cache
def catalogue(language: str) -> Mapping[str, str]:
    """Return the words of a language by code; KeyError where there is no such language."""
    if language not in LANGUAGES:
        raise KeyError(language)
    path = Path(__file__).parent / f"{language}.json"
    texts: Mapping[str, str] = json.loads(path.read_text(encoding="utf-8"))
    return texts


def say(statement: Statement, language: str = ENGLISH) -> str:
    """Return the words of a statement in a language."""
    words = catalogue(language)
    pattern = words.get(statement.code, statement.english or statement.code)
    if not statement.values:
        return pattern
    return pattern.format_map({k: _filled(v, language) for k, v in statement.values.items()})


def say_sentence(parts: Sequence[Statement], language: str = ENGLISH) -> str:
    """Return statements as one sentence, joined by semicolons, with its full stop or question mark."""
    text = catalogue(language)["word.semicolon"].join(say(p, language) for p in parts)
    return f"{upper_first(text)}{'' if text.endswith(('?', '.')) else '.'}" if text else ""


def _filled(value: Value, language: str) -> str:
    if isinstance(value, Statement):
        return say(value, language)
    if isinstance(value, Figure):
        return value.text.replace(".", catalogue(language)["number.point"])
    if isinstance(value, Listed):
        return _joined([_filled(v, language) for v in value.items], value.by, language)
    if isinstance(value, Clause):
        text = say(value.of, language).split(";")[0].rstrip(".")
        # A German sentence may begin with a noun, whose capital stays.
        return lower_first(text) if language == ENGLISH else text
    return str(value)


def _joined(words: Sequence[str], by: str, language: str) -> str:
    texts = catalogue(language)
    if by in ("comma", "semicolon"):
        return texts[f"word.{by}"].join(words)
    if by == "titles":
        ends = {w.rpartition(" ")[2] for w in words}
        if len(words) > 1 and len(ends) == 1 and all(w.count(" ") == 1 for w in words):
            return f"{_joined([w.partition(' ')[0] for w in words], 'and', language)} {ends.pop()}"
    if len(words) < 2:
        return "".join(words)
    last = texts["word.or" if by == "or" else "word.and"]
    return f"{texts['word.comma'].join(words[:-1])}{last}{words[-1]}"


def lower_first(text: str) -> str:
    """Return the text with its first letter small, unless it begins with a name such as A1."""
    return text if text[1:2].isdigit() or text[:2].isupper() else text[:1].lower() + text[1:]


def upper_first(text: str) -> str:
    """Return the text with its first letter a capital."""
    return text[:1].upper() + text[1:]
