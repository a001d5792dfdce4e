"""The page's catalogues: the same keys in every language, and exactly those that the page uses."""

import ast
import re
from pathlib import Path
from typing import get_args

import pytest

from invid import errors
from invid.config import load_config
from invid.effects.registry import CATALOGUE
from invid.effects.sizes import QUANTITIES
from invid.model.diagnosis_document import Grade
from invid.numerics.compiled import COMPILING
from invid.planning import make_plan
from invid.wording.sentence import LANGUAGES, catalogue
from invid_drivers.cia402.supervisor import STOPPING
from invid_service.cells.readiness import Note, Reason
from invid_service.jobs.progress import STAGES
from invid_service.jobs.states import State
from invid_service.jobs.stops import STOPS, Run, action_for
from invid_service.jobs.worker import error_info
from invid_service.problems import STATUSES
from invid_service.web import texts
from invid_service.web.pages import preferred
from invid_service.web.texts import texts_of
from invid_service.words import ACTIONS, ERRORS, HALTS, NOTES, PROBLEMS, REASONS

ROOT = Path(__file__).parents[3]
WEB = Path(texts.__file__).parent
ENGLISH = texts_of("en")
KINDS_OF_ERROR = (
    "DiskFullError", "ConfigError", "RecordingError", "NotIdentifiableError", "SafetyStop", "DriveError",
    "BusError",
)  # fmt: skip
FAMILIES = {key.split(".")[0] for key in ENGLISH}


def sources() -> dict[str, str]:
    files = [*sorted((WEB / "static").glob("*.js")), WEB / "templates" / "page.html"]
    return {f.name: f.read_text(encoding="utf-8") for f in files}


def used() -> tuple[set[str], set[str]]:
    """Keys named in full, and beginnings that are completed while the page runs ("state.")."""
    whole, begun = set[str](), set[str]()
    for text in sources().values():
        begun |= {p for p in re.findall(r"[`\"]([a-z_]+\.)(?:\$\{|\" ~)", text) if p[:-1] in FAMILIES}
        begun |= {f"{f}." for f in re.findall(r"\bnamed\(\"([a-z]+)\"", text)}
        named = re.findall(r"\"([a-z]+\.[a-z_.]+)\"", text)
        whole |= {k for k in named if k.split(".")[0] in FAMILIES and not k.endswith((".js", ".json"))}
    # Not texts but names of files and of keys beside them.
    return whole - {"report.html", "model.json", "diagnosis.json", "recording.h"}, begun


@pytest.mark.parametrize("language", LANGUAGES[1:])
def test_every_language_has_the_same_keys_and_the_same_gaps_to_fill(language: str) -> None:
    other = texts_of(language)
    assert other.keys() == ENGLISH.keys()
    for key, text in ENGLISH.items():
        gaps = set(re.findall(r"\{\w+\}", text)), set(re.findall(r"\{\w+\}", other[key]))
        assert gaps[0] == gaps[1], key
        assert other[key].strip(), key


def test_every_key_that_the_page_uses_is_there() -> None:
    whole, begun = used()
    assert len(whole) > 150, "the pattern finds what it is meant to find"
    assert whole - ENGLISH.keys() == set()
    for beginning in begun:
        assert any(k.startswith(beginning) for k in ENGLISH), beginning


def test_no_text_is_kept_that_nothing_shows() -> None:
    whole, begun = used()
    fetched = {"phase.", "language."}  # by the service, and by the phases that it names
    unused = [k for k in ENGLISH if k not in whole and not any(k.startswith(b) for b in begun | fetched)]
    assert unused == []


def test_what_the_service_may_name_has_a_name_in_every_language() -> None:
    reference = (ROOT / "docs" / "reference" / "causes.md").read_text(encoding="utf-8")
    measures = re.findall(r"^\|[^|]+\| `(\w+)`", reference, re.M)
    assert "gravity_fraction_of_rated" in measures
    for language in LANGUAGES:
        known = texts_of(language)
        wanted = {f"cause.{e.cause}" for e in CATALOGUE}
        wanted |= {f"effect.{p}" for e in CATALOGUE for p in e.parameters}
        wanted |= {f"state.{s}" for s in State} | {f"grade.{g}" for g in Grade}
        assert wanted - known.keys() == set()
    assert set(measures) <= QUANTITIES.keys()


def test_what_the_service_may_say_by_a_code_is_said() -> None:
    kinds = {error_info(getattr(errors, name)("x")).code for name in KINDS_OF_ERROR}
    assert kinds <= ERRORS.keys()
    of_drives = {"axis_energised", "axis_suspect"}  # said where they are seen
    assert set(get_args(Reason.model_fields["code"].annotation)) - of_drives <= REASONS.keys()
    assert set(get_args(Note.model_fields["code"].annotation)) - of_drives <= NOTES.keys()
    assert STATUSES.keys() == PROBLEMS.keys()
    stops = [Run("full", "planned", False, "A1"), Run("test", "planned", False, "A1")]
    assert set(STOPS) <= HALTS.keys()
    assert {action_for(code, run)["code"] for code in STOPS for run in stops} <= ACTIONS.keys()


def test_whatever_may_stop_a_motion_has_its_action_and_its_words() -> None:
    raised = set[str]()
    for path in [*(ROOT / "invid" / "sweep").rglob("*.py"), *(ROOT / "drivers").rglob("cia402/*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in (
                "SafetyStop",
                "DriveError",
                "BusError",
            ):
                codes = [k.value for k in node.keywords if k.arg == "code"]
                raised |= {c.value for code in codes for c in ast.walk(code) if isinstance(c, ast.Constant)}
    assert {"stands", "asked", "bus"} <= raised
    assert raised - set(STOPS) == set()


def test_every_phase_of_a_sweep_and_of_an_analysis_has_its_words() -> None:
    config = load_config(ROOT / "configs" / "case-study.yaml")
    core = ROOT / "invid"
    told = {
        stage
        for path in core.rglob("*.py")
        for stage in re.findall(r"\btell\(\s*f?\"([^\"]+)\"", path.read_text(encoding="utf-8"))
    }
    assert {"still looking", "fitting the machine alone"} <= told
    names = [p.name for p in make_plan(config).phases] + [COMPILING, *STAGES, *told - {"weighing"}]
    for name in [*names, STOPPING]:  # "weighing" comes with its cause, which the page names
        assert f"phase.{name}" in ENGLISH or getattr(name, "template", "") in catalogue("de"), name


@pytest.mark.parametrize(
    ("header", "language"),
    [
        ("", "en"),
        ("de", "de"),
        ("de-CH,de;q=0.9,en;q=0.8", "de"),
        ("en-GB,en;q=0.9,de;q=0.8", "en"),
        ("fr,de;q=0.5,en;q=0.4", "de"),
        ("fr-FR,it;q=0.9", "en"),
        ("de;q=0,en", "en"),
        ("de;q=abc,en;q=0.1", "en"),
        (";;,,=;q", "en"),
    ],
)
def test_the_browser_chooses_the_language(header: str, language: str) -> None:
    assert preferred(header) == language
