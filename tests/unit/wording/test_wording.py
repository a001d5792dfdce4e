"""The words of statements: the same codes in every language, and each of those that are built."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import invid
from invid.effects.registry import CATALOGUE
from invid.model.doubts import DoubtCode
from invid.wording.statement import LANGUAGES, catalogue

ENGLISH = catalogue("en")


@pytest.mark.parametrize("language", LANGUAGES[1:])
def test_every_language_has_the_same_codes_and_the_same_gaps(language: str) -> None:
    other = catalogue(language)
    assert other.keys() == ENGLISH.keys()
    for code, text in ENGLISH.items():
        assert set(re.findall(r"\{\w+\}", text)) == set(re.findall(r"\{\w+\}", other[code])), code
        assert other[code].strip() or not text.strip(), code


def test_every_code_that_the_core_builds_has_its_words() -> None:
    sources = [p.read_text(encoding="utf-8") for p in Path(invid.__file__).parent.rglob("*.py")]
    built = {code for s in sources for code in re.findall(r"Statement\(\s*\"([a-z_]+\.[a-z_.]+)\"", s)}
    assert len(built) > 60, "the pattern finds what it is meant to find"
    assert built - ENGLISH.keys() == set()
    assert {f"doubt.{code}" for code in DoubtCode} <= ENGLISH.keys()


def test_an_effect_says_of_itself_what_the_english_catalogue_says() -> None:
    for effect in CATALOGUE:
        assert ENGLISH[f"cause.{effect.cause}"] == effect.title.split(" (")[0]
        assert ENGLISH[f"check.{effect.cause}"] == effect.check
