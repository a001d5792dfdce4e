"""Values for the drives: worked out on a finished run and shown; the drives' loops measured."""

import re
from pathlib import Path

import pytest
from page_browser import Page, browser, needs_browser
from service_process import STIFF_CELL, serving

SAMPLED_CELL = STIFF_CELL.replace(
    "of_rated: 0.002}", "of_rated: 0.002, loop_cycle_s: 0.001, position_loop_Hz: 8}"
)
"""Its drives' loops run as `invid tune` takes drives to be, and are so soft that added torque moves them."""
pytestmark = [pytest.mark.browser, pytest.mark.service]


@pytest.mark.campaign
@needs_browser
@pytest.mark.parametrize(
    ("language", "words"),
    [
        ("en", ("Following error", "Save all files", "timid gains", "predicted|machine")),
        (
            "de",
            (
                "Schleppfehler",
                "Alle Dateien speichern",
                "vorsichtige Verstärkungen",
                "wie|schlechter|Maschine",
            ),
        ),
    ],
)
def test_a_person_has_values_worked_out_and_the_loops_measured(
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
        page.press(page.shown("verify"))
        page.press(page.shown("arm"))
        page.wait_text("verified", "A1", 120)
        assert re.search(words[3], page.text("sentence")), page.text("sentence")
        assert page.drawing().tag_name == "svg"
        for size in (1280, 390):
            driver.set_window_size(size, 900)
            assert page.overflow() <= 0, size
        driver.set_window_size(1280, 900)
        severe = [e for e in driver.get_log("browser") if e["level"] == "SEVERE"]
        assert [e for e in severe if "409" not in e["message"]] == []
