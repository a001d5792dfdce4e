"""The page in headless Chromium: a person who never saw it re-identifies the small simulated cell."""

import contextlib
import sqlite3
import time
from pathlib import Path

import pytest
from page_browser import looking, needs_browser
from service_process import STIFF_CELL, serving

pytestmark = [pytest.mark.browser, pytest.mark.service]
NOTHING_LEFT = """
const now = {run: "0", state: "analysing", progress: 0.8, phase: "identifying", eta_s: 0, found: []};
const clock = Date.now, done = arguments[0];
import("/static/progress.js").then(({showProgress}) => {
  Date.now = () => 1e12;
  try { showProgress(now); } finally { Date.now = clock; }
  return document.getElementById("bar").value;
}).then(done, (error) => done(String(error)));
"""
"""A word that no time is left, in the instant in which it comes."""


@pytest.mark.campaign
@pytest.mark.panel
@needs_browser
def test_a_person_sees_readiness_and_the_plan_arms_watches_and_accepts_on_the_page(tmp_path: Path) -> None:
    with serving(tmp_path) as service, looking(tmp_path, service) as page:
        page.wait_text("ready-title", "Ready to measure")
        assert page.driver.execute_async_script(NOTHING_LEFT) == pytest.approx(0.8), "the bar stands for good"
        assert page.shown("simulated").text == "SIMULATED: no hardware"
        page.unfold("facts")
        assert "57.3°" in page.text("drives"), "limits are said as the plan says them"
        assert page.small_targets() == []
        page.press(page.shown("prepare"))
        page.shown("arm")
        assert "A1" in page.text("plan-table")
        assert "N·m" in page.text("plan-table")
        assert "s of robot time" in page.text("plan-facts")
        # What will move and how far: foreseen, or bounded by where the sweep stops.
        assert "°" in page.text("plan-table")
        assert "unknown" not in page.text("plan-table")
        assert page.small_targets() == []
        page.press(page.driver.find_element("id", "arm"))
        page.wait_text("run-title", "Measuring")
        assert not page.stop_covered()
        page.press(page.shown("accept", 300))
        page.wait_text("decision", "accepted")
        page.driver.execute_script("window.scrollTo(0, 0)")
        page.driver.find_element("css selector", "[data-view=history]").click()
        page.wait_text("accepted", "in force")
        # A second entry to compare with: the history asks as the result does, for means of runs that agree.
        with contextlib.closing(sqlite3.connect(tmp_path / "data" / "store.sqlite")) as store, store:
            store.execute(
                "INSERT INTO approvals (cell, model, at, by, how)"
                " SELECT cell, model, at, by, how FROM approvals"
            )
        page.driver.find_element("css selector", "[data-view=work]").click()
        page.driver.find_element("css selector", "[data-view=history]").click()
        page.wait_text("accepted", "Compare with now")
        # It keeps 250 and then no more: polls.
        page.driver.execute_script("performance.clearResourceTimings()")
        page.press(page.driver.find_element("css selector", "#accepted .actions button"))
        page.wait_text("history-changes", "Nothing changed")
        asked = page.driver.execute_script("return performance.getEntriesByType('resource').map(e => e.name)")
        assert any("/changes?" in a and a.endswith("&averaged=true") for a in asked)
        assert page.mistakes() == []


@pytest.mark.campaign
@pytest.mark.timeout(900)
@needs_browser
def test_a_result_says_first_where_it_is_and_whether_to_accept_and_its_numbers_unfold(
    finished: str, tmp_path: Path
) -> None:
    # With dry friction far above the noise there is a cause to be shown.
    with serving(tmp_path, cell=STIFF_CELL) as service, looking(tmp_path, service) as page:
        page.shown("accept")
        assert "Dry friction on A1" in page.text("sentence")
        assert "As expected" in page.text("grade")
        drawing = page.drawing()
        assert drawing.tag_name == "svg"
        assert "dry friction" in drawing.text
        assert not page.driver.find_element("id", "frf").is_displayed()
        page.unfold("numbers")
        page.shown("frf")
        assert page.driver.find_element("id", "frf-plot").find_elements("tag name", "canvas")
        assert page.driver.find_element("id", "missing-plot").find_elements("tag name", "canvas")
        cause = page.shown("causes").find_element("tag name", "figure")
        assert "dry friction at the motor" in cause.text
        sides = cause.find_elements("tag name", "button")
        assert [b.text for b in sides] == [
            "over velocity", "over position", "over deflection", "over frequency",
        ]  # fmt: skip
        for side in sides:
            page.press(side)
            assert side.get_attribute("aria-pressed") == "true"
            assert cause.find_elements("tag name", "canvas")
        assert "left with the cause" in cause.text
        parameters = page.text("parameters")
        for name in ("A1 mass 1", "A1 mass 2 (final)", "A1 spring 1", "±"):
            assert name in parameters
        for width in (1280, 800, 390):
            page.driver.set_window_size(width, 900)
            time.sleep(0.5)
            assert page.overflow() <= 0, width
            assert not page.stop_covered(), width
            assert page.small_targets() == [], width
        assert page.mistakes() == []


@pytest.mark.campaign
@needs_browser
def test_the_page_says_so_when_the_service_is_gone(tmp_path: Path) -> None:
    with serving(tmp_path) as service, looking(tmp_path, service, 390, 800) as page:
        page.wait_text("ready-title", "Ready")
        service.kill()
        page.driver.execute_script("window.scrollTo(0, 1e5)")
        page.driver.execute_script("document.getElementById('prepare').click()")
        assert "cannot be reached" in page.shown("problem").text
        where = "return document.getElementById('problem').getBoundingClientRect().top"
        assert 0 <= page.driver.execute_script(where) < 400, "a button that does nothing says nothing"
        assert "emergency stop" in page.shown("offline", 20).text
        assert not page.driver.find_element("id", "prepare").is_enabled()
        page.driver.find_element("id", "stop").click()
        page.wait_text("stop-note", "USE THE EMERGENCY STOP")
