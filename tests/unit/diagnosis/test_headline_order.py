"""The headline answers in this order: what changed, does it matter, where, what now; in both languages."""

from dataclasses import replace
from typing import Any

import pytest

from invid.diagnosis.headline import Facts, headline
from invid.model.diagnosis_document import Alternative, Consequence, Finding, Grade, Verdict
from invid.model.document import EffectTerm, Estimate
from invid.model.doubts import Doubt, DoubtCode
from invid.model.named_change import ChangeKind, NamedChange, is_tool_change
from invid.wording.sentence import say

UNIT = "kg·m²"
LOAD = NamedChange(
    ChangeKind.LOAD, "A2", "A2.mass.3", 3, difference=1.31, std=0.02, unit=UNIT, share=1.31 / 5.97
)
SOFTER = NamedChange(
    ChangeKind.SPRING, "A1", "A1.spring.1", 1, difference=-190.0, std=3.0, unit="N·m/rad", share=-0.19
)
COUPLED = NamedChange(
    ChangeKind.COUPLING, "A1", other_axis="A2", difference=0.3, std=0.02, unit=UNIT, share=0.1
)
SMALL = replace(LOAD, difference=0.06, std=0.004, share=0.01, matters=False)
MISSED = Doubt(DoubtCode.MISSED_TORQUE, "The model cannot be trusted: …", {"share": 0.79})
UNSEEN = Doubt(DoubtCode.UNSEEN, "A1.spring.2: not seen by these data")
TOOL = "New load on A2: +1.31 ± 0.02 kg·m² (+22 %); looks like a tool change."
WERKZEUG = "Neue Last an A2: +1,31 ± 0,02 kg·m² (+22 %); sieht nach einem Werkzeugwechsel aus."
SOFT = "Spring 1 of A1 is softer: −190 ± 3 N·m/rad (−19 %)."
WEICH = "Feder 1 von A1 ist weicher: −190 ± 3 N·m/rad (−19 %)."
NOT_79 = "This result is not to be trusted: the model misses 79 % of the torque"
NICHT_79 = "Diesem Ergebnis ist nicht zu trauen: dem Modell fehlen 79 % des Moments"
CALM, RUHE = (
    "nothing beyond noise on both axes: nothing to do.",
    "nichts außer Rauschen an beiden Achsen: nichts zu tun.",
)
NONE, NICHTS = (
    "Nothing changed since the accepted model",
    "Nichts hat sich seit dem angenommenen Modell geändert",
)
TABLE = [
    # changes, doubt, English, German
    (None, None, CALM, RUHE),
    ((), None, f"{NONE}; {CALM}", f"{NICHTS}; {RUHE}"),
    ((SMALL,), None, f"New load on A2: +0.060 ± 0.004 kg·m² (+1 %), too small to matter; {CALM}",
     f"Neue Last an A2: +0,060 ± 0,004 kg·m² (+1 %), zu klein, um zu zählen; {RUHE}"),
    ((LOAD,), None, f"{TOOL} Accept?", f"{WERKZEUG} Annehmen?"),
    ((LOAD, COUPLED), None, f"{TOOL} Accept?", f"{WERKZEUG} Annehmen?"),
    ((SOFTER,), None, f"{SOFT} Before accepting: check belt tension, screws and the gear for wear.",
     f"{WEICH} Vor dem Annehmen: Riemenspannung, Schrauben und Verschleiß des Getriebes prüfen."),
    (None, MISSED, f"{NOT_79}.", f"{NICHT_79}."),
    ((), MISSED, f"{NOT_79}.", f"{NICHT_79}."),
    ((LOAD,), MISSED, f"{NOT_79}; whether anything changed cannot be told from it.",
     f"{NICHT_79}; ob sich etwas geändert hat, ist daraus nicht zu sagen."),
    ((SOFTER,), MISSED, f"{NOT_79}; whether anything changed cannot be told from it.",
     f"{NICHT_79}; ob sich etwas geändert hat, ist daraus nicht zu sagen."),
    ((LOAD,), UNSEEN, f"{TOOL} Accept only for a reason: the data do not carry the whole model.",
     f"{WERKZEUG} Nur aus einem Grund annehmen: die Daten tragen nicht das ganze Modell."),
    ((SOFTER,), UNSEEN, f"{SOFT} Accept only for a reason: the data do not carry the whole model.",
     f"{WEICH} Nur aus einem Grund annehmen: die Daten tragen nicht das ganze Modell."),
    ((SMALL,), UNSEEN, "This result is not to be trusted: the data do not carry the whole model; whether "
     "anything changed cannot be told from it.", None),
]  # fmt: skip


def facts(changes: tuple[NamedChange, ...] | None, doubt: Doubt | None = None, **more: Any) -> Facts:
    return replace(Facts(("A1", "A2"), False, Verdict.CONSISTENT, changes=changes, doubt=doubt), **more)


def capital(text: str) -> str:
    return text[:1].upper() + text[1:]


@pytest.mark.parametrize(("changes", "doubt", "english", "german"), TABLE)
def test_the_headline_says_what_changed_whether_it_matters_where_and_what_now(
    changes: tuple[NamedChange, ...] | None, doubt: Doubt | None, english: str, german: str | None
) -> None:
    assert headline(facts(changes, doubt)) == capital(english)
    if german is not None:
        assert say(headline(facts(changes, doubt)), "de") == capital(german)


def finding(cause: str, axis: str, grade: Grade) -> Finding:
    term = EffectTerm(cause, axis, {"gap": Estimate(3e-3, 1e-5, "rad")}, "spring 1")
    means = Consequence(grade, "3 mrad (10′) of play", "", measures={"backlash": 3e-3})
    return Finding(term, 0.99, 0.4, 0.05, 0.9, consequence=means)


@pytest.mark.parametrize(
    ("confidence", "rivals"), [(0.5, ()), (0.89, (Alternative("spring_hysteresis", "A1", "spring 1", 0.1),))]
)
def test_a_doubtful_cause_asks_for_the_experiment_that_makes_sure_and_for_no_repair(
    confidence: float, rivals: tuple[Alternative, ...]
) -> None:
    sure = finding("cubic_stiffness", "A1", Grade.ACT)
    doubtful = replace(sure, confidence=confidence, alternatives=rivals)

    def said(of: Finding, language: str = "en") -> str:
        return say(headline(facts(None, verdict=Verdict.EXPLAINED, findings=(of,))), language)

    assert said(sure).endswith("check gear, belt or coupling for preload and wear.")
    assert said(doubtful).endswith(
        ": not sure yet: measure again at another amplitude before anything is repaired."
    )
    assert "noch einmal mit anderer Amplitude messen, bevor etwas repariert wird." in said(doubtful, "de")
    assert "check" not in said(doubtful)


def test_a_tool_changes_loads_how_they_couple_and_how_they_weigh_and_nothing_else() -> None:
    weight = NamedChange(ChangeKind.GREW, "A2", cause="gravity")
    friction = NamedChange(ChangeKind.GREW, "A2", cause="coulomb_friction")
    assert is_tool_change((LOAD, COUPLED, weight))
    assert is_tool_change((LOAD, replace(SOFTER, matters=False)))
    assert not is_tool_change((LOAD, SOFTER))
    assert not is_tool_change((LOAD, friction))
    assert not is_tool_change((COUPLED,))
    assert not is_tool_change(())


def test_a_short_check_says_what_is_new_and_not_what_the_accepted_model_left_as_well() -> None:
    lost = facts((), verdict=Verdict.UNEXPLAINED, unexplained_axis="A1", screened=Verdict.PARTLY_EXPLAINED)
    assert headline(lost) == f"{NONE}; as in the accepted model, something is left that has no name."
    new = replace(lost, screened=Verdict.EXPLAINED)
    assert headline(new).endswith("the accepted model does not have: measure in full to tell what.")
    changed = headline(facts((SOFTER,), screened=Verdict.EXPLAINED))
    assert changed == f"{SOFT} Measure in full to take it over."
