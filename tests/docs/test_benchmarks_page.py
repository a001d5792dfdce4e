"""The page of benchmarks comes out of its command: every section, its command, what that printed."""

import re

from pages import ROOT

from benchmarks import run_all

PAGE = (ROOT / "docs" / "reference" / "benchmarks.md").read_text(encoding="utf-8")


def test_the_page_in_the_docs_has_every_section_of_the_command() -> None:
    assert re.findall(r"^## (.*)$", PAGE, re.M) == [s.title for s in run_all.SECTIONS]
