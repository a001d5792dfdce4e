"""The page of benchmarks comes out of its command: every section, its command, what that printed."""

from __future__ import annotations

import re
from collections.abc import Sequence

import pytest
from pages import ROOT

from benchmarks import page as benchmarks_page

PAGE = (ROOT / "docs" / "reference" / "benchmarks.md").read_text(encoding="utf-8")


def printing(command: Sequence[str]) -> benchmarks_page.Ran:
    """Stands for a benchmark: prints its own command; the one of the peers misses a bar."""
    missed = "peer" in command[0]
    return benchmarks_page.Ran(f"  ran {' '.join(command)}\n", int(missed), 1.0)


@pytest.mark.parametrize("quick", [True, False])
def test_the_page_holds_what_each_benchmark_printed_and_says_which_missed_a_bar(quick: bool) -> None:
    text, missed = benchmarks_page.page(quick=quick, runner=printing)
    assert missed == 1
    assert text.count("a bar is missed") == 1
    for section in benchmarks_page.SECTIONS:
        assert f"## {section.title}" in text
        arguments = section.quick if quick else section.full
        assert f"  ran benchmarks/{section.script} {' '.join(arguments)}".rstrip() in text


def test_a_long_table_says_how_much_is_left_out() -> None:
    assert benchmarks_page.shortened("1\n2\n3\n4", 2) == "1\n2\n… (2 lines more)"


def test_the_page_in_the_docs_has_every_section_of_the_command() -> None:
    assert re.findall(r"^## (.*)$", PAGE, re.M) == [s.title for s in benchmarks_page.SECTIONS]
