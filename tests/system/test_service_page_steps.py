"""The page at the moments that count: what is wrong, does it matter, where, what now; for whom."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from page_browser import Page, browser, needs_browser
from service_process import STIFF_CELL, serving

pytestmark = [pytest.mark.campaign, pytest.mark.browser, pytest.mark.service, needs_browser]


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
