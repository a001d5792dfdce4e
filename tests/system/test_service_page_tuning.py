"""The card with values for the drives: pressed on a finished run, worked out, shown, saved."""

from __future__ import annotations

from pathlib import Path

import pytest
from page_browser import Page, browser, needs_browser
from service_process import STIFF_CELL, serving

pytestmark = [pytest.mark.browser, pytest.mark.service]


@pytest.mark.campaign
@needs_browser
@pytest.mark.parametrize(
    ("language", "words"),
    [("en", ("Following error", "Save all files")), ("de", ("Schleppfehler", "Alle Dateien speichern"))],
)
def test_a_person_has_the_values_worked_out_and_sees_what_they_bring(
    tmp_path: Path, finished: str, language: str, words: tuple[str, str]
) -> None:
    with (
        serving(tmp_path, cell=STIFF_CELL) as service,
        browser(tmp_path / "profile", language=language) as driver,
    ):
        page = Page(driver)
        driver.get(f"{service.url}/#{finished.rsplit('/', 1)[-1]}")
        page.press(page.shown("tune"))
        page.shown("tuned", 180)
        table = page.shown("tuned").find_element("tag name", "table")
        assert words[0] in table.text
        assert "A1" in table.text
        assert words[1] in page.text("tuned")
        assert page.shown("tuned").find_elements("css selector", "figure svg")
        assert page.small_targets() == []
        assert [e for e in driver.get_log("browser") if e["level"] == "SEVERE"] == []
