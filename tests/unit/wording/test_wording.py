"""The words of statements: the same codes in every language, and each of those that are built."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import invid
from invid.effects.registry import CATALOGUE
from invid.model.doubts import DoubtCode
from invid.wording.figures import signed_share
from invid.wording.statement import LANGUAGES, Figure, Listed, Statement, catalogue, say, say_sentence

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


def test_a_cause_that_somebody_added_is_called_by_its_own_title() -> None:
    assert say(Statement("cause.quadratic_drag", english="drag"), "de") == "drag"


def test_figures_have_the_point_of_the_language_and_lists_its_and() -> None:
    by = Statement("change.load", {"axis": "A2.x", "by": Figure("+1.31 ± 0.02 kg·m²")})
    assert say(by, "de") == "neue Last an A2.x: +1,31 ± 0,02 kg·m²"
    assert say_sentence([Statement("now.accept")], "de") == "Annehmen?"
    titles = Listed((Statement("cause.coulomb_friction"), Statement("cause.viscous_friction")), "titles")
    both = Statement("headline.on", {"what": titles, "axes": Listed(("A1", "A2"))})
    assert say(both) == "dry and viscous friction on A1 and A2"
    assert say(both, "de") == "trockene und zähe Reibung an A1 und A2"


def test_a_share_that_says_nothing_is_left_out() -> None:
    assert signed_share(1.31, 5.97) == "+22 %"
    assert signed_share(-0.19, 1.0) == "−19 %"
    assert signed_share(2.0, 1.0) == "+200 %"
    assert signed_share(-3.0, 1.0) == "−300 %"
    assert signed_share(1.0, 0.0) == ""
