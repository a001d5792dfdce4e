"""What the manuals say, as rows: an unknown counts as the worst, and the docs say the same as the code."""

import runpy
from pathlib import Path

import pytest

from invid_drivers.cia402.stated.vendors import VENDORS

ROOT = Path(__file__).parents[3]
TABLES = runpy.run_path(str(ROOT / "scripts" / "drive-tables.py"))
QUESTIONS, fact, reference = (TABLES[n] for n in ("QUESTIONS", "fact", "reference"))
PAGE = (ROOT / "docs" / "reference" / "drives.md").read_text(encoding="utf-8")


def test_of_a_generic_drive_nothing_is_assumed() -> None:
    assert {fact(VENDORS["generic"], name) for name in QUESTIONS} == {"unknown"}


@pytest.mark.parametrize("name", list(VENDORS))
def test_every_fact_names_its_source_and_every_source_a_fact(name: str) -> None:
    row = VENDORS[name]
    assert {f for f in QUESTIONS if fact(row, f) != "unknown"} == set(row.sources)


def test_the_reference_shows_the_facts_of_the_code() -> None:
    assert reference() in PAGE
