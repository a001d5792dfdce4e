"""Values for the drives: worked out on a finished run, shown, written by name, measured, written back."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from page_browser import Page, browser, needs_browser
from service_process import STIFF_CELL, serving

SAMPLED_CELL = STIFF_CELL.replace("of_rated: 0.002}", "of_rated: 0.002, loop_cycle_s: 0.001}")
"""Its drives' loops run as `invid tune` takes drives to be."""
pytestmark = [pytest.mark.browser, pytest.mark.service]


@pytest.mark.campaign
@needs_browser
@pytest.mark.parametrize(
    ("language", "words"),
    [
        ("en", ("Following error", "Save all files", "read from the drives", "as predicted|better")),
        ("de", ("Schleppfehler", "Alle Dateien speichern", "was jetzt in den Antrieben steht", "wie|besser")),
    ],
)
def test_a_person_has_values_worked_out_written_measured_and_written_back(
    tmp_path: Path, finished: str, language: str, words: tuple[str, ...]
) -> None:
    with (
        serving(tmp_path, cell=SAMPLED_CELL) as service,
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
        assert words[2] in page.text("tuned")
        assert page.shown("tuned").find_elements("css selector", "figure svg")
        page.press(page.shown("apply-look"))
        page.wait_text("apply-list", "0x2500:1")
        form = driver.find_element("css selector", "#apply form.ask")
        field, write = (
            form.find_element("tag name", "input"),
            form.find_element("css selector", "[type=submit]"),
        )
        assert not write.is_enabled(), "nobody has named the robot"
        for size in (1280, 390):
            driver.set_window_size(size, 900)
            assert page.overflow() <= 0, size
            assert page.small_targets() == [], size
            driver.execute_script("document.getElementById('apply').scrollIntoView()")
        driver.set_window_size(1280, 900)
        field.send_keys("another robot")
        page.press(write)
        page.wait_text("problem", "small cell")
        page.press(page.shown("apply-look"))
        page.wait_text("apply-list", "0x2500:1")
        form = driver.find_element("css selector", "#apply form.ask")
        form.find_element("tag name", "input").send_keys("small cell")
        page.press(form.find_element("css selector", "[type=submit]"))
        page.wait_text("apply-found", "4")
        page.press(page.shown("apply-verify"))
        page.press(page.shown("arm"))
        page.wait_text("verified", "A1", 120)
        assert re.search(words[3], page.text("sentence")), page.text("sentence")
        assert page.drawing().tag_name == "svg"
        for size in (1280, 390):
            driver.set_window_size(size, 900)
            assert page.overflow() <= 0, size
        driver.set_window_size(1280, 900)
        page.press(page.shown("apply-undo"))
        page.wait_text("verified", "small cell")
        form = driver.find_element("css selector", "#verified form.ask")
        form.find_element("tag name", "input").send_keys("small cell")
        page.press(form.find_element("css selector", "[type=submit]"))
        page.wait_text("apply-found", "4")
        severe = [e for e in driver.get_log("browser") if e["level"] == "SEVERE"]
        assert [e for e in severe if "409" not in e["message"]] == []
