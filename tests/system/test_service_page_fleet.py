"""Twenty cells in one table: worst first, sorted, filtered, measured and accepted from it."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from page_browser import Page, browser, needs_browser
from page_fleet import CELLS, plant

pytestmark = [
    pytest.mark.browser,
    pytest.mark.service,
    pytest.mark.campaign,
    pytest.mark.panel,
    needs_browser,
]
ROWS = "return [...document.querySelectorAll('#fleet-rows tr')].filter((r) => !r.hidden)"


def test_twenty_cells_are_seen_worst_first_and_measured_and_accepted_from_their_table(tmp_path: Path) -> None:
    with plant(tmp_path) as service, browser(tmp_path / "profile") as driver:
        page = Page(driver)
        page.resize(1280, 800)

        def order() -> list[str]:
            return [str(c) for c in driver.execute_script(f"{ROWS}.map((r) => r.dataset.cell)")]

        def text(cell: str) -> str:
            script = "return document.querySelector(`tr[data-cell=${arguments[0]}]`)?.innerText ?? ''"
            return str(driver.execute_script(script, cell))

        def wait(cell: str, words: str) -> None:
            deadline = time.monotonic() + 60
            while words not in text(cell):
                assert time.monotonic() < deadline, text(cell)
                time.sleep(0.1)

        def press(selector: str) -> None:
            page.press(driver.find_element("css selector", selector))

        driver.get(service.url + "/")
        press("[data-view=overview]")
        wait("r06", "yesterday")
        page.wait_text("counts", "15 ready")
        assert len(order()) == CELLS
        assert order()[:5] == ["r05", "r04", "r03", "r02", "r01"], (
            "to act on, failed, stopped, then who waits"
        )
        assert order()[5:7] == ["r19", "r20"], "never measured, before those measured longest ago"
        assert order()[7:] == [f"r{n:02d}" for n in range(18, 5, -1)]
        for row, told in {
            "r05": ("Act", "4 hours ago"),
            "r04": ("Failed", "The bus failed"),
            "r01": ("Waiting for a decision", "final mass", "tool change"),
            "r19": ("Ready", "never measured"),
        }.items():
            for words in told:
                assert words.lower() in text(row).lower(), (row, text(row))
        for width, height, least in ((1280, 800, 9), (800, 1280, 7), (390, 844, 3)):
            page.resize(width, height)
            driver.execute_script("window.scrollTo(0, 0)")
            bottom = "document.getElementById('stopbar').getBoundingClientRect().top"
            inside = f"{ROWS}.filter((r) => r.getBoundingClientRect().bottom <= {bottom}).length"
            assert driver.execute_script(inside) >= least, width
            assert "final mass" in driver.find_element("css selector", "tr[data-cell=r01]").text, width
            driver.save_screenshot(str(tmp_path / f"fleet-{width}.png"))
            assert page.overflow() <= 0, width
            assert page.small_targets() == [], width
            assert page.barriers() == [], width
        page.resize(1280, 800)
        press("[data-rank=waits]")
        assert order() == ["r02", "r01"]
        press("[data-rank=waits]")
        driver.find_element("id", "fleet-search").send_keys("ROBOT 1")
        assert sorted(order()) == [f"r{n}" for n in range(10, 20)]
        press("th[data-by=cell] button")
        assert order() == [f"r{n}" for n in range(10, 20)]
        press("th[data-by=cell] button")
        assert order() == [f"r{n}" for n in range(19, 9, -1)]
        assert "descending" in str(
            driver.find_element("css selector", "th[data-by=cell]").get_attribute("aria-sort")
        )
        # Measured from the table; armed only where what moves is seen.
        press("tr[data-cell=r19] .act button")
        wait("r19", "Ready to move")
        assert "Look" in text("r19")
        driver.find_element("id", "fleet-search").clear()
        driver.find_element("id", "fleet-search").send_keys("0")
        # What is not to be trusted is looked at first; the other one is accepted here, and asks before.
        assert "Look" in text("r02")
        press("tr[data-cell=r01] .act button")
        question = driver.find_element("css selector", "tr[data-cell=r01] form.ask")
        assert "New load on A1" in question.text
        assert not page.stop_covered()
        page.press(question.find_element("css selector", "[type=submit]"))
        wait("r01", "Ready")
        accepted = service.client.get("/api/v1/cells/r01/models").json()
        assert len(accepted["history"]) == 2
        press("tr[data-cell=r01] .cell button")
        page.wait_text("ready-title", "Ready")
        assert driver.find_element("id", "cell").get_attribute("value") == "r01"
        assert page.mistakes() == []
