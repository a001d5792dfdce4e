"""What core and service say in English has its words in every language, and none of what is gone is left."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from invid.planning.build import UNKNOWN
from invid_service.web.texts import LANGUAGES, sayings

ROOT = Path(__file__).parents[3]
SPEAKERS = ["invid", "drivers/invid_drivers", "service/invid_service"]
WARNERS = [
    "invid/planning", "invid/sweep", "invid/signals/periods.py", "invid/identification", "invid/likelihood",
    "invid/diagnosis", "invid/comparison/compare.py", "drivers/invid_drivers/measurement.py",
]  # fmt: skip
"""Whose warnings the page shows of a cell that it measures."""
REFUSERS = [
    "drivers/invid_drivers/adapters.py", "drivers/invid_drivers/round_trip.py",
    "drivers/invid_drivers/cia402",
]  # fmt: skip
REFUSALS = ("DriveError", "BusError", "SafetyStop")
GAP = "§"


@cache
def patterns(language: str) -> dict[str, re.Pattern[str]]:
    """As ``said.js`` reads them."""
    found = {}
    for text in sayings(language):
        met = set[str]()

        def gap(match: re.Match[str], met: set[str] = met) -> str:
            number = match[1]
            again, _ = number in met, met.add(number)
            return rf"(?P=v{number})" if again else rf"(?P<v{number}>.*?)"

        found[text] = re.compile(re.sub(r"\\\{(\d+)\\\}", gap, re.escape(text)))
    return found


def is_said(text: str, language: str) -> bool:
    def known(part: str) -> bool:
        return not part.strip(GAP) or any(p.fullmatch(part) for p in patterns(language).values())

    return known(text) or all(map(known, text.split("; ")))


def templates(node: ast.AST) -> list[str]:
    """Texts that an expression may be, with ``GAP`` for what is filled in."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return [node.value]
    if isinstance(node, ast.JoinedStr):
        return ["".join(v.value if isinstance(v, ast.Constant) else GAP for v in node.values)]  # type: ignore[misc]
    if isinstance(node, ast.IfExp):
        return templates(node.body) + templates(node.orelse)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return [a + b for a in templates(node.left) or [GAP] for b in templates(node.right) or [GAP]]
    if isinstance(node, ast.List | ast.Tuple):
        return [t for item in node.elts for t in templates(item)]
    if isinstance(node, ast.ListComp):
        return templates(node.elt)
    return []


def files(*places: str) -> Iterator[Path]:
    for place in places:
        path = ROOT / place
        yield from [path] if path.is_file() else sorted(path.rglob("*.py"))


@cache
def spoken() -> frozenset[str]:
    """Every text in the code that may be said."""
    nodes = (n for f in files(*SPEAKERS) for n in ast.walk(ast.parse(f.read_text(encoding="utf-8"))))
    whole = {t for n in nodes for t in templates(n)}
    return frozenset(part for t in whole for part in [t, *re.split("; |(?<=[.]) ", t)])


def warned() -> Iterator[tuple[str, str]]:
    """Texts that are appended to warnings, with their files."""
    for path in files(*WARNERS):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for text in (t for n in _appended(node) for t in templates(n)):
                yield str(path.relative_to(ROOT)), text


def _appended(node: ast.AST) -> list[ast.expr]:
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        is_list = node.func.attr == "append" and "warning" in ast.unparse(node.func.value)
        return node.args if is_list else []
    if isinstance(node, ast.AugAssign):
        return [node.value] if "warning" in ast.unparse(node.target) else []
    return [node.value] if isinstance(node, ast.keyword) and node.arg == "warnings" else []


@pytest.mark.parametrize("language", LANGUAGES[1:])
def test_a_sentence_has_the_same_gaps_in_every_language_and_is_another_one(language: str) -> None:
    for english, other in sayings(language).items():
        gaps = set(re.findall(r"\{\d+\}", english)), set(re.findall(r"\{\d+\}", other))
        assert gaps[1] <= gaps[0], english
        assert other.strip(), english


@pytest.mark.parametrize("language", LANGUAGES[1:])
def test_every_warning_of_a_measurement_and_its_analysis_has_its_words(language: str) -> None:
    assert is_said(UNKNOWN, language)
    missing = [f"{place}: {text}" for place, text in warned() if not is_said(text, language)]
    assert missing == []


def refused() -> Iterator[tuple[str, str]]:
    """Texts with which drives, bus and adapter refuse or end a motion, with their files."""
    for path in files(*REFUSERS):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or ast.unparse(node.func) not in REFUSALS:
                continue
            said = [*node.args, *(k.value for k in node.keywords if k.arg == "way_out")]
            texts = [t for argument in said for t in templates(argument)]
            yield from ((str(path.relative_to(ROOT)), t) for t in texts if t.count(" ") > 2)


@pytest.mark.parametrize("language", LANGUAGES[1:])
def test_every_refusal_of_drives_and_bus_has_its_words(language: str) -> None:
    texts = list(refused())
    assert len(texts) > 50
    assert [f"{place}: {text}" for place, text in texts if not is_said(text, language)] == []


@pytest.mark.parametrize("language", LANGUAGES[1:])
def test_no_sentence_is_kept_that_nobody_says(language: str) -> None:
    stale = [
        english
        for english, pattern in patterns(language).items()
        if english.count(" ") > 3 and not any(pattern.fullmatch(text) for text in spoken())
    ]
    assert stale == []
