"""Every template in the code has its words in every language, and none is kept that nobody says.

No warning or refusal goes by them.
"""

import ast
import json
import pickle
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from string import Formatter

import pytest
from pydantic import BaseModel

from invid.errors import DriveError
from invid.model.document import dump_json, parse_json
from invid.wording.fields import Text
from invid.wording.sentence import (
    LANGUAGES,
    Figure,
    Sentence,
    capital,
    catalogue,
    clause,
    joined,
    listed,
    say,
    sentence,
    wording_of,
)

ROOT = Path(__file__).parents[3]
SPEAKERS = ["invid", "drivers/invid_drivers", "service/invid_service"]
PAGE = "service/invid_service/web/texts.json"
MAKERS = {"sentence": 0, "marked": 0, "Experiment": 1}
"""Calls that are given a template, and as which argument."""
WARNERS = [
    "invid/planning", "invid/sweep", "invid/signals/periods.py", "invid/identification", "invid/likelihood",
    "invid/diagnosis", "invid/comparison/compare.py", "drivers/invid_drivers/measurement.py",
]  # fmt: skip
"""Whose warnings the page shows of a cell that it measures."""
REFUSERS = [
    "drivers/invid_drivers/adapters.py",
    "drivers/invid_drivers/round_trip.py",
    "drivers/invid_drivers/cia402",
]
REFUSALS = ("DriveError", "BusError", "SafetyStop")


def files(*places: str) -> Iterator[Path]:
    for place in places:
        path = ROOT / place
        yield from [path] if path.is_file() else sorted(path.rglob("*.py"))


def nodes(*places: str) -> Iterator[tuple[str, ast.AST]]:
    for path in files(*places):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            yield str(path.relative_to(ROOT)), node


def gaps(template: str) -> set[str]:
    return {name for _, name, _, _ in Formatter().parse(template) if name is not None}


def plain(template: str) -> str:
    """As the catalogues have it: without formats."""
    parts = Formatter().parse(template)
    return "".join(
        literal.replace("{", "{{").replace("}", "}}") + ("" if name is None else f"{{{name}}}")
        for literal, name, _, _ in parts
    )


def has_words(template: str) -> bool:
    return any(re.search(r"[^\W\d_]{2}", literal) for literal, *_ in Formatter().parse(template))


@cache
def templates() -> dict[str, str]:
    """Every template with words, by where it stands in the code."""
    found = {}
    for place, node in nodes(*SPEAKERS):
        given, named = list[ast.expr](), set[str]()
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in MAKERS:
            given = node.args[MAKERS[node.func.id] :][:1]
        elif isinstance(node, ast.Assign) and place.startswith("invid/effects"):
            named = {t.id for t in node.targets if isinstance(t, ast.Name)}
            given = [node.value] if named & {"title", "check"} else []
        for argument in given:
            if isinstance(argument, ast.Constant) and isinstance(argument.value, str):
                found[plain(argument.value)] = place
                name = argument.value.partition(" (")[0]
                found |= {t: place for t in (name, bare(name)) if "title" in named}
    found |= dict.fromkeys(json.loads((ROOT / PAGE).read_text(encoding="utf-8")).values(), PAGE)
    return {t: place for t, place in found.items() if has_words(t)}


def bare(title: str) -> str:
    return title.removeprefix("a ").removeprefix("an ")


@pytest.mark.parametrize("language", LANGUAGES[1:])
def test_every_template_has_its_words_and_none_is_kept_that_nobody_says(language: str) -> None:
    words = catalogue(language)
    assert len(templates()) > 500, "the walk finds what it is meant to find"
    assert {t: place for t, place in templates().items() if t not in words} == {}
    assert [t for t in words if t not in templates()] == []


@pytest.mark.parametrize("language", LANGUAGES[1:])
def test_words_fill_no_gap_that_their_template_has_not(language: str) -> None:
    for template, words in catalogue(language).items():
        assert words.strip(), template
        assert gaps(words) <= gaps(template), template


def is_bare(text: ast.expr) -> bool:
    """Whether an expression is words that no other language has."""
    if isinstance(text, ast.Constant):
        return isinstance(text.value, str) and text.value.count(" ") > 2
    if isinstance(text, ast.JoinedStr):
        return sum(v.value.count(" ") for v in text.values if isinstance(v, ast.Constant)) > 2
    if isinstance(text, ast.BinOp):
        return is_bare(text.left) or is_bare(text.right)
    if isinstance(text, ast.IfExp):
        return is_bare(text.body) or is_bare(text.orelse)
    if isinstance(text, ast.List | ast.Tuple):
        return any(map(is_bare, text.elts))
    return isinstance(text, ast.ListComp) and is_bare(text.elt)


def warned(node: ast.AST) -> list[ast.expr]:
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        is_list = node.func.attr == "append" and "warning" in ast.unparse(node.func.value)
        return node.args if is_list else []
    if isinstance(node, ast.AugAssign):
        return [node.value] if "warning" in ast.unparse(node.target) else []
    return [node.value] if isinstance(node, ast.keyword) and node.arg == "warnings" else []


def test_every_warning_of_a_measurement_and_its_analysis_is_a_sentence() -> None:
    found = [
        (place, ast.unparse(text))
        for place, node in nodes(*WARNERS)
        for text in warned(node)
        if is_bare(text)
    ]
    assert found == []


def test_every_refusal_of_drives_and_bus_is_a_sentence() -> None:
    found = []
    for place, node in nodes(*REFUSERS):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in REFUSALS:
            said = [*node.args, *(k.value for k in node.keywords if k.arg == "way_out")]
            found += [(place, ast.unparse(text)) for text in said if is_bare(text)]
    assert found == []


FAULT = sentence("axis {axis}: velocity {speed:.3g} {unit}/s, limit {limit:.3g}", axis="A1.5", speed=2.345,
                 unit="rad", limit=2)  # fmt: skip


def test_it_is_the_english_text_and_only_its_numbers_have_a_decimal_comma() -> None:
    assert FAULT == "axis A1.5: velocity 2.35 rad/s, limit 2"
    assert say(FAULT, "de") == "Achse A1.5: Geschwindigkeit 2,35 rad/s, Grenze 2"
    assert say("as it came", "de") == "as it came"


def test_parts_are_said_in_turn_and_in_their_form() -> None:
    found = listed([sentence("travel"), sentence("torque"), "A7"], alternatives=True)
    assert (found, say(found, "de")) == ("travel, torque or A7", "Weg, Moment oder A7")
    check = clause(sentence("Check the encoder's mounting and its coupling."))
    assert check == "check the encoder's mounting and its coupling"
    assert say(check, "de") == "Befestigung und Kupplung des Gebers prüfen"
    assert say(capital(found), "de") == "Weg, Moment oder A7"


def test_it_goes_through_processes_documents_bodies_and_errors() -> None:
    class Body(BaseModel):
        text: Text

    whole = capital(joined([FAULT, sentence("lower the amplitude")], "; "))
    document = {"warnings": [whole], "rows": [{"size": Figure("2.5 N·m")}], "name": "A1"}
    read = parse_json(dump_json(document))
    assert read == document
    error = pickle.loads(pickle.dumps(DriveError(FAULT, way_out=sentence("lower the amplitude"))))
    german = "Achse A1.5: Geschwindigkeit 2,35 rad/s, Grenze 2; die Amplitude senken"
    for found in (pickle.loads(pickle.dumps(whole)), read["warnings"][0], Body(text=whole).text, str(error)):
        assert isinstance(found, Sentence)
        assert say(found, "de") == german
    assert json.loads(Body(text=whole).model_dump_json()) == {"text": str(whole)}
    assert wording_of([Body(text=FAULT)])[FAULT]["values"]["speed"] == {"figure": "2.35"}


def test_a_document_without_sentences_has_no_table_and_a_foreign_one_is_read_as_it_is() -> None:
    assert "wording" not in json.loads(dump_json({"warnings": ["as it came"]}))
    assert parse_json('{"wording": "of mine", "a": 1}') == {"wording": "of mine", "a": 1}
