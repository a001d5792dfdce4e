"""A sentence is its English text wherever it goes, and is said in another language from what it carries."""

from __future__ import annotations

import json
import pickle

from pydantic import BaseModel

from invid.errors import DriveError
from invid.model.document import dump_json, parse_json
from invid.wording.fields import Text
from invid.wording.sentence import (
    Figure,
    Sentence,
    capital,
    clause,
    joined,
    listed,
    say,
    sentence,
    wording_of,
)

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
