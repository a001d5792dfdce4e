"""The page at the moments that count: what is wrong, does it matter, where, what now; for whom."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest
from page_browser import Page, browser, needs_browser
from service_process import SMALL_CELL, STIFF_CELL, serving

pytestmark = [pytest.mark.campaign, pytest.mark.browser, pytest.mark.service, needs_browser]
# Members that the service gives in other situations than a small healthy cell can be brought into.
ANSWERS = """const real = window.fetch;
window.asked = [];
window.fetch = async (url, options = {}) => {
  const added = %s, method = options.method ?? "GET", path = new URL(url, location.href).pathname;
  let body = typeof options.body === "string" ? JSON.parse(options.body) : null;
  if (body) {
    window.asked.push(structuredClone(body));
    if (added.separating) { delete body.separate; delete body.amplitude; }
    options = { ...options, body: JSON.stringify(body) };
  }
  const response = await real(url, options);
  if (!response.headers.get("content-type")?.includes("application/json")) return response;
  const document_ = await response.json();
  if (/identifications\\/[^/]+$/.test(path) && method === "GET") {
    for (const [name, value] of Object.entries(added)) {
      if (value.states.includes(document_.state)) document_[name] = value.is;
    }
  }
  return new Response(JSON.stringify(document_), { status: response.status, headers: response.headers });
};"""


def answering(driver: Any, **added: Any) -> None:
    """Add members to the identifications that the page is told of: ``name={"is": …, "states": […]}``."""
    driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": ANSWERS % json.dumps(added)})


def on_screen(page: Page, identity: str) -> bool:
    """Whether all of it lies between the top and the stop bar, without scrolling."""
    script = """const box = (id) => document.getElementById(id).getBoundingClientRect();
      const b = box(arguments[0]);
      return b.height > 0 && b.top >= 0 && b.bottom <= box('stopbar').top"""
    return bool(page.driver.execute_script(script, identity))


def test_the_first_screen_of_a_tablet_holds_headline_grade_drawing_and_decision(
    finished: str, tmp_path: Path
) -> None:
    with serving(tmp_path, cell=STIFF_CELL) as service, browser(tmp_path / "profile") as driver:
        page = Page(driver)
        page.resize(800, 1280)
        driver.get(service.url + "/")
        assert "mass 1" not in page.drawing().text
        for part in ("grade", "sentence", "where", "accept", "reject"):
            assert on_screen(page, part), part
        assert not driver.find_element("id", "parameters").is_displayed()
        # In the picture, at the motor, and in the list: the same number.
        assert "1" in [t.text for t in page.drawing().find_elements("css selector", "text")]
        assert "1\nA1: dry friction at the motor" in page.text("findings")
        assert "As expected" in page.text("findings")
        assert service.client.get(finished + "/drawing").text.count("<path") > 3
        for width, height in ((390, 844), (800, 1280), (1280, 900)):
            page.resize(width, height)
            for scheme in ("light", "dark"):
                page.shown_as(scheme)
                assert page.overflow() <= 0, width
                assert not page.stop_covered(), width
                driver.save_screenshot(str(tmp_path / f"result-{width}-{scheme}.png"))
        page.shown_as("light", "print")
        head = page.shown("print-head").text
        for known in (finished.rsplit("/", 1)[1], "Started by local", "invid 0"):
            assert known in head
        assert not driver.find_element("id", "stop").is_displayed()
        page.shown_as("light")
        driver.execute_script("window.dispatchEvent(new Event('beforeprint'))")
        assert driver.find_element("id", "parameters").is_displayed(), "paper cannot be unfolded"
        driver.execute_script("window.dispatchEvent(new Event('afterprint'))")
        assert not driver.find_element("id", "parameters").is_displayed()
        assert page.mistakes() == []


def test_the_page_is_without_barriers_at_every_step(tmp_path: Path) -> None:
    with serving(tmp_path, cell=STIFF_CELL) as service, browser(tmp_path / "profile") as driver:
        page = Page(driver)
        page.resize(800, 1280)

        def look(step: str) -> None:
            for scheme in ("dark", "light"):
                page.shown_as(scheme)
                assert page.barriers() == [], f"{step}, {scheme}"
            assert page.nameless_pictures() == [], step

        driver.get(service.url + "/")
        page.wait_text("ready-title", "Ready")
        page.unfold("facts")
        look("ready")
        page.press(page.shown("prepare"))
        page.shown("arm")
        look("plan")
        page.press(driver.find_element("id", "arm"))
        page.wait_text("run-title", "Measuring")
        look("moving")
        page.shown("accept", 120)
        page.drawing()
        look("result")
        for fold in ("sentences-box", "numbers"):
            page.unfold(fold)
        page.shown("frf-plot")
        time.sleep(1.0)
        look("numbers")
        assert "peaks at" in driver.find_element("id", "frf-plot").get_attribute("aria-label")
        page.press(page.shown("accept"))
        page.wait_text("decision", "accepted")
        driver.execute_script("window.scrollTo(0, 0)")
        for view in ("history", "overview", "upload"):
            driver.find_element("css selector", f"[data-view={view}]").click()
            page.shown(f"view-{view}")
            time.sleep(0.5)
            if view == "history":
                page.press(driver.find_element("css selector", "#charts summary"))
                page.wait_text("charts", "A1 mass 2")
            look(view)
            driver.execute_script("window.scrollTo(0, 0)")
        page.resize(390, 844)
        look("upload on a phone")


def test_the_whole_job_is_done_by_keyboard(tmp_path: Path) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    with serving(tmp_path) as service, browser(tmp_path / "profile") as driver:
        page = Page(driver)

        def press(*keys: str) -> None:
            ActionChains(driver).send_keys(*keys).perform()

        def tab_to(identity: str, most: int = 25) -> None:
            for _ in range(most):
                if driver.switch_to.active_element.get_attribute("id") == identity:
                    return
                press(Keys.TAB)
            page.wait_focus(identity, 0.1)

        driver.get(service.url + "/")
        page.wait_text("ready-title", "Ready")
        tab_to("prepare")
        press(Keys.ENTER)
        page.shown("arm")
        page.wait_focus("run-title")
        tab_to("arm", 4)
        press(Keys.ENTER)
        page.shown("accept", 120)
        # The next action is close behind the headline, which is read first.
        page.wait_focus("sentence")
        page.drawing()
        tab_to("accept", 3)
        press(Keys.ENTER)
        page.wait_text("decision", "accepted by local")
        tab_to("again", 15)
        press(Keys.ENTER)
        page.wait_text("ready-title", "Ready")
        page.wait_text("in-force", "accepted")


def test_a_stopped_run_shows_where_why_the_last_seconds_and_the_one_action(tmp_path: Path) -> None:
    seconds = [-2.0 + 0.01 * k for k in range(201)]
    moved = [0.001 * k if k < 150 else 0.15 + 0.02 * (k - 150) for k in range(201)]
    stopped = {
        "code": "position_window",
        "phase": "experiment 1 of 2",
        "axis": "A1",
        "reason": "axis A1: position left its window: 1.15 rad from the start, limit 1.0",
        "action": {"code": "gentler", "text": "Start again with half of the torque.", "where": "page"},
        "trace": {"time_s": seconds, "position": {"A1": moved}, "torque": {"A1": [5.0] * 201}},
    }
    cell = SMALL_CELL.replace("periods: 3}", "periods: 60}")
    with serving(tmp_path, cell=cell) as service, browser(tmp_path / "profile", 800, 1280) as driver:
        answering(driver, stopped={"is": stopped, "states": ["stopped"]})
        page = Page(driver)
        location = service.start()
        service.wait(location, "running")
        driver.get(service.url + "/")
        page.wait_text("run-title", "Measuring")
        driver.find_element("id", "stop").click()
        service.wait(location, "stopped", timeout=10)
        page.shown("stopped")
        assert "1.15 rad from the start, limit 1.0" in page.text("run-error")
        assert "What to do" not in page.text("run-error"), "one action, and it stands below"
        assert "experiment 1 of 2, axis A1" in page.text("stopped-where")
        assert page.text("stopped-action") == "Start again with half of the torque."
        labels = [c.get_attribute("aria-label") for c in page.shown("trace").find_elements("tag name", "svg")]
        assert "the limit is ±57.3 °" in labels[0], "as in the plan"
        assert "at the end 65.9 °" in labels[0]
        assert len(labels) == 2
        assert page.barriers() == []
        assert page.nameless_pictures() == []
        driver.add_cookie({"name": "invid-language", "value": "de", "path": "/"})
        driver.refresh()
        page.wait_text("run-error", "weiter, als sie darf")
        assert "1,15 rad vom Anfang, erlaubt 1,0" in page.text("run-error")
        page.press(page.shown("stopped-do"))
        deadline = time.monotonic() + 10
        while not (asked := [a for a in driver.execute_script("return window.asked") if "mode" in a]):
            assert time.monotonic() < deadline
        assert asked[-1] == {"mode": "full", "amplitude": "gentler", "axes": ["A1"]}
