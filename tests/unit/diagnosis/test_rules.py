"""Special rules of the search: listed, switched, recorded; the search itself knows none."""

from __future__ import annotations

import sys
from itertools import count
from pathlib import Path

import grimp
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from hidden.generator import make

from invid.cli.app import run
from invid.diagnosis import context as rules_asked
from invid.diagnosis.context import Rule, Stage, apply_rule, context_without, use_context
from invid.diagnosis.diagnose import diagnose
from invid.diagnosis.rules.catalogue import BY_NAME, RULES
from invid.errors import InputError
from invid.model.diagnosis_document import diagnosis_to_json
from invid.recording import write_recording

SEARCH = (
    "search",
    "search_pass",
    "linear_fit",
    "candidates",
    "score_test",
    "evidence",
    "selection",
    "verdict",
)


def test_every_rule_says_why_and_from_where_and_has_a_name_of_its_own() -> None:
    assert len({r.name for r in RULES}) == len(RULES)
    for rule in RULES:
        assert rule.reason.endswith("."), rule.name
        assert rule.source, rule.name
        assert rule.name == rule.name.lower().replace("_", "-").replace(" ", "-")


def test_the_search_imports_no_rule() -> None:
    graph = grimp.build_graph("invid", cache_dir=None)
    for module in SEARCH:
        needs = graph.find_modules_directly_imported_by(f"invid.diagnosis.{module}")
        assert not [n for n in needs if n.startswith("invid.diagnosis.rules")], module


def test_the_search_asks_every_rule_by_a_name_that_exists() -> None:
    folder = Path(rules_asked.__file__).parent
    text = "".join(p.read_text(encoding="utf-8") for p in folder.glob("*.py"))
    asked = {
        part.split('"')[1] for part in text.replace("\n", " ").split("apply_rule(")[1:] if '"' in part[:40]
    }
    assert asked - {"friction-ladder"} <= set(BY_NAME)
    assert set(BY_NAME) <= asked


def test_a_rule_that_is_off_hands_back_what_there_is_without_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[int] = []

    def add(values: list[int], more: int) -> list[int]:
        calls.append(more)
        return [*values, more]

    rule = Rule("add", Stage.STEP, "It adds.", "here", add, applies=lambda values, more: more > 0)
    monkeypatch.setattr("invid.diagnosis.context.rules_by_name", lambda: {"add": rule})
    ticks = count()
    start = [1]
    with use_context(context_without([], clock=lambda: float(next(ticks)))) as context:
        assert apply_rule("add", start, 2) == [1, 2]
        assert apply_rule("add", start, 0) is start
    assert calls == [2]
    assert [a.to_json() for a in context.asked] == [
        {"rule": "add", "stage": "step", "pass": 1, "changed": True, "chi2": None, "cpu_s": 1.0}
    ]
    with use_context(context_without(["add"])) as context:
        assert apply_rule("add", start, 2) is start
    assert calls == [2]
    assert context.asked == []
    with pytest.raises(InputError, match="--without-rule sub: no rule of that name; there are add"):
        context_without(["sub"])


def test_the_diagnosis_lists_the_rules_that_changed_something_and_takes_them_out(
    tmp_path: Path,
) -> None:
    recording, _ = make("asymmetric_friction", seed=5, motors=1, target_db=30)
    full = diagnose(recording)
    fired = [entry["rule"] for entry in diagnosis_to_json(full)["details"]["rules"]]
    assert fired
    assert set(fired) <= set(BY_NAME)
    assert all("cpu_s" not in entry for entry in full.details["rules"])  # two runs are alike
    with use_context(context_without(fired)):
        bare = diagnose(recording)
    assert not {entry["rule"] for entry in bare.details["rules"]} & set(fired)
    write_recording(recording, tmp_path / "rec.h5")
    assert run(["diagnose", str(tmp_path / "rec.h5"), "--without-rule", "no-such"]) == 2
