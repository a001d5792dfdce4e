"""What a person said was changed is answered first: the same, more, less, elsewhere, not visible, unknown."""

from dataclasses import replace

import numpy as np
import pytest
from stated_models import model_of

from invid.comparison.answers import answer_expectation
from invid.comparison.compare import compare
from invid.diagnosis.headline import Facts, headline
from invid.model.chains import case_study
from invid.model.diagnosis_document import Verdict
from invid.model.document import Model, parameter_vector
from invid.model.expectation import Agreement, Answer, Expectation, Subject
from invid.wording.sentence import say

TOOL = Expectation(Subject.TOOL, "A2", 1.3)


def model(relative: float = 1e-3, **parts: float) -> Model:
    """The case study with its masses, springs and couplings known to ``relative``; ``parts`` are added to the
    final mass of an axis ("A2") or to its first spring ("A2_spring")."""
    chains = case_study(damping_ratio=0.01)
    names, values = parameter_vector(chains)
    found = dict(zip(names, values, strict=True))
    for name, by in parts.items():
        axis, _, is_spring = name.partition("_")
        found[
            f"{axis}.spring.1" if is_spring else f"{axis}.mass.{len(chains.masses[chains.axes.index(axis)])}"
        ] += by
    return model_of(chains, found, relative * np.maximum(np.abs(values), 0.1))


def answer(said: Expectation, relative: float = 1e-3, **parts: float) -> Answer:
    return answer_expectation(said, compare(model(relative), model(relative, **parts)))


@pytest.mark.parametrize(
    ("said", "parts", "agreement"),
    [
        (TOOL, {"A2": 1.31}, Agreement.AS_SAID),
        (TOOL, {"A2": 1.0}, Agreement.AS_SAID),  # "about"
        (TOOL, {"A2": 2.6}, Agreement.MORE),
        (TOOL, {"A2": 0.4}, Agreement.LESS),
        (TOOL, {"A2": -1.3}, Agreement.OPPOSITE),
        (TOOL, {"A3": 1.31}, Agreement.ELSEWHERE),
        (TOOL, {}, Agreement.NOT_VISIBLE),
        (TOOL, {"A1_spring": -150.0}, Agreement.NOT_VISIBLE),  # another change is none of the tool
        (replace(TOOL, axis=None), {"A3": 1.31}, Agreement.AS_SAID),
        (replace(TOOL, size=None), {"A2": 0.5}, Agreement.AS_SAID),
        (replace(TOOL, size=None, mass=1.3), {"A2": 1.31}, Agreement.SIZE_OPEN),
        (replace(TOOL, size=None, mass=-1.3), {"A2": 1.31}, Agreement.OPPOSITE),
        (Expectation(Subject.TRANSMISSION, "A1"), {"A1_spring": -150.0}, Agreement.AS_SAID),
        (Expectation(Subject.TRANSMISSION, "A1"), {"A2": 1.3}, Agreement.NOT_VISIBLE),
        (Expectation(Subject.LUBRICATION, "A1"), {}, Agreement.NOT_VISIBLE),
    ],
)
def test_what_was_said_is_held_against_what_changed_in_the_plant(
    said: Expectation, parts: dict[str, float], agreement: Agreement
) -> None:
    assert answer(said, **parts).agreement is agreement


def said(given: Answer, language: str = "en", **parts: float) -> str:
    changes = compare(model(), model(**parts)).named if given.change is None else (given.change,)
    return say(
        headline(Facts(("A1", "A2"), False, Verdict.CONSISTENT, changes=changes, answer=given)), language
    )


def test_the_first_clause_of_the_headline_is_the_answer_in_both_languages() -> None:
    found = answer(TOOL, A2=1.31)
    assert said(found).startswith("As you said, new load on A2: +1.31")
    assert said(found).endswith("Accept?")
    assert said(found, "de").startswith("Wie angegeben, neue Last an A2: +1,31")
    more = said(answer(TOOL, A2=2.6))
    assert more.startswith("More than you said (another tool on A2, about +1.3 kg·m²), new load on A2: +2.6")
    absent = said(answer(TOOL))
    assert absent.startswith(
        "What you said (another tool on A2, about +1.3 kg·m²) is not visible, and beyond ±"
    )
    assert "nothing changed" in absent.lower()
    # A mass alone is no inertia: the distance at which it would be one is told, for a person to judge.
    mass = said(answer(replace(TOOL, size=None, mass=1.3), A2=1.31))
    assert "what 1.3 kg makes at 1 m from the axis" in mass
