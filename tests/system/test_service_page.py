"""The page in headless Chromium: a person who never saw it re-identifies the small simulated cell."""

from __future__ import annotations

import contextlib
import shutil
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from service_process import SMALL_CELL, serving

pytestmark = [pytest.mark.browser, pytest.mark.xdist_group("service")]
BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
needs_browser = pytest.mark.skipif(
    not (BROWSER and DRIVER),
    reason="CHROMIUM IS MISSING: the page is not tested; apt-get install chromium-driver",
)
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@contextmanager
def browser(profile: Path, width: int = 1280, height: int = 900) -> Iterator[Any]:
    """A fresh Chromium."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    for flag in [*FLAGS, f"--user-data-dir={profile}", f"--window-size={width},{height}"]:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    options.binary_location = str(BROWSER)
    driver = webdriver.Chrome(options=options, service=Service(str(DRIVER)))
    try:
        yield driver
    finally:
        driver.quit()


class Page:
    """What a person does with it."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def shown(self, identity: str, timeout: float = 90.0) -> Any:
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            found = self.driver.find_element("id", identity)
            if found.is_displayed():
                return found
            time.sleep(0.1)
        raise AssertionError(
            f"#{identity} never showed: " + self.driver.find_element("id", "main").text[:2000]
        )

    def press(self, element: Any) -> None:
        """A click in the middle of the screen, where the stop bar does not lie over it."""
        self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
        element.click()

    def unfold(self, identity: str) -> None:
        """Open a fold that is there."""
        self.press(self.shown(identity).find_element("tag name", "summary"))

    def text(self, identity: str) -> str:
        return str(self.driver.find_element("id", identity).text)

    def wait_text(self, identity: str, text: str, timeout: float = 60.0) -> None:
        deadline = time.monotonic() + timeout
        while text not in self.text(identity):
            assert time.monotonic() < deadline, f"#{identity}: {self.text(identity)!r}, not {text!r}"
            time.sleep(0.1)

    def wait_focus(self, identity: str, timeout: float = 10.0) -> None:
        deadline = time.monotonic() + timeout
        while (at := self.driver.switch_to.active_element.get_attribute("id")) != identity:
            assert time.monotonic() < deadline, f"the focus is on {at!r}, not {identity!r}"
            time.sleep(0.1)

    def small_targets(self) -> list[str]:
        """Visible buttons, choices and links that a glove would miss."""
        script = """const names = 'button, select, .choices label, summary, .links a';
          const size = (e) => Math.min(e.getBoundingClientRect().height, e.getBoundingClientRect().width);
          return [...document.querySelectorAll(names)].filter(e => e.offsetParent && size(e) < 48)
            .map(e => e.textContent.trim())"""
        return list(self.driver.execute_script(script))

    def stop_covered(self) -> bool:
        """True where something lies over the middle of the stop button, or it is not on the screen."""
        script = """const b = document.getElementById('stop').getBoundingClientRect();
          const e = document.elementFromPoint(b.x + b.width / 2, b.y + b.height / 2);
          return !e || e.id !== 'stop'"""
        return bool(self.driver.execute_script(script))

    def drawing(self) -> Any:
        """The picture of the branches, once the service has drawn it."""
        self.shown("where")
        return self.driver.find_element("css selector", "#drawing svg")

    def overflow(self) -> int:
        """Pixels by which the page is wider than its window."""
        script = "return document.documentElement.scrollWidth - document.documentElement.clientWidth"
        return int(self.driver.execute_script(script))

    def mistakes(self) -> list[str]:
        """Errors in the browser's log (a 404 on purpose is none)."""
        return [e["message"] for e in self.driver.get_log("browser") if e["level"] == "SEVERE"]


@needs_browser
def test_a_person_sees_readiness_and_the_plan_arms_watches_and_accepts_on_the_page(tmp_path: Path) -> None:
    # With dry friction far above the noise there is a cause to be shown.
    stiff = SMALL_CELL + "  axes: {A1: {friction: {coulomb_Nm: 1.0}}}\n"
    with serving(tmp_path, cell=stiff) as service, browser(tmp_path / "profile") as driver:
        page = Page(driver)
        driver.get(service.url + "/")
        page.wait_text("ready-title", "Ready to measure")
        assert page.shown("simulated").text == "SIMULATED: no hardware"
        assert page.small_targets() == []
        page.shown("prepare").click()
        page.shown("arm")
        assert "A1" in page.text("plan-table")
        assert "N·m" in page.text("plan-table")
        assert "s of robot time" in page.text("plan-facts")
        # What will move and how far: foreseen, or bounded by where the sweep stops.
        assert "°" in page.text("plan-table")
        assert "unknown" not in page.text("plan-table")
        assert page.small_targets() == []
        driver.find_element("id", "arm").click()
        page.wait_text("run-title", "Measuring")
        assert not page.stop_covered()
        assert page.shown("live").find_elements("tag name", "canvas")
        accept = page.shown("accept", 120)
        # First where it is, and whether to accept; the numbers unfold.
        assert "Dry friction on A1" in page.text("sentence")
        assert "As expected" in page.text("grade")
        drawing = page.drawing()
        assert drawing.tag_name == "svg"
        assert "dry friction" in drawing.text
        assert not driver.find_element("id", "frf").is_displayed()
        page.unfold("numbers")
        page.shown("frf")
        assert driver.find_element("id", "frf-plot").find_elements("tag name", "canvas")
        assert driver.find_element("id", "missing-plot").find_elements("tag name", "canvas")
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
            driver.set_window_size(width, 900)
            time.sleep(0.5)
            assert page.overflow() <= 0, width
            assert not page.stop_covered(), width
            assert page.small_targets() == [], width
            driver.save_screenshot(str(tmp_path / f"result-{width}.png"))
        driver.set_window_size(1280, 900)
        page.press(accept)
        page.wait_text("decision", "accepted")
        driver.execute_script("window.scrollTo(0, 0)")
        driver.find_element("css selector", "[data-view=history]").click()
        page.wait_text("accepted", "in force")
        # A second entry to compare with: the history asks as the result does, for means of runs that agree.
        with contextlib.closing(sqlite3.connect(tmp_path / "data" / "store.sqlite")) as store, store:
            store.execute(
                "INSERT INTO approvals (cell, model, at, by, how)"
                " SELECT cell, model, at, by, how FROM approvals"
            )
        driver.find_element("css selector", "[data-view=work]").click()
        driver.find_element("css selector", "[data-view=history]").click()
        page.wait_text("accepted", "Compare with now")
        driver.find_element("css selector", "#accepted .actions button").click()
        page.wait_text("history-changes", "Nothing changed")
        asked = driver.execute_script("return performance.getEntriesByType('resource').map(e => e.name)")
        assert any("/changes?" in a and a.endswith("&averaged=true") for a in asked)
        assert page.mistakes() == []
        # The next run does not begin with the picture of the last one.
        driver.find_element("css selector", "[data-view=work]").click()
        page.press(driver.find_element("id", "again"))
        location = service.start(arm=False)
        page.wait_text("run-title", "Ready to move")
        assert driver.find_element("id", "live").get_attribute("hidden") is not None
        service.client.post(f"{location}/actions", json={"type": "cancel"})
    assert (tmp_path / "result-800.png").stat().st_size > 10_000


@needs_browser
def test_the_stop_button_and_the_escape_key_stop_the_robot_at_once(tmp_path: Path) -> None:
    from selenium.webdriver.common.keys import Keys

    # The page asks every three seconds; on a fast machine the whole small run is over by then.
    cell = SMALL_CELL.replace("periods: 3}", "periods: 60}")
    with serving(tmp_path, cell=cell) as service, browser(tmp_path / "profile", 800, 1100) as driver:
        page = Page(driver)
        driver.get(service.url + "/")
        page.shown("stop").click()
        page.wait_text("stop-note", "Nothing was moving")
        location = service.start()
        page.wait_text("run-title", "Measuring")
        began = time.monotonic()
        driver.find_element("tag name", "body").send_keys(Keys.ESCAPE)
        page.wait_text("stop-note", "STOP sent.")
        service.wait(location, "stopped", timeout=10)
        assert time.monotonic() - began < 5
        page.wait_text("run-title", "Stopped")
        assert "What to do" in page.text("run-error")


@needs_browser
def test_the_page_says_so_when_the_service_is_gone(tmp_path: Path) -> None:
    with serving(tmp_path) as service, browser(tmp_path / "profile", 390, 800) as driver:
        page = Page(driver)
        driver.get(service.url + "/")
        page.wait_text("ready-title", "Ready")
        service.kill()
        assert "emergency stop" in page.shown("offline", 20).text
        driver.execute_script("window.scrollTo(0, 1e5)")
        driver.execute_script("document.getElementById('prepare').click()")
        assert "cannot be reached" in page.shown("problem").text
        top = driver.execute_script("return document.getElementById('problem').getBoundingClientRect().top")
        assert 0 <= top < 400, "a button that does nothing says nothing"
        driver.find_element("id", "stop").click()
        page.wait_text("stop-note", "USE THE EMERGENCY STOP")


@needs_browser
def test_everything_can_be_reached_by_keyboard_with_a_visible_focus(tmp_path: Path) -> None:
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    with serving(tmp_path) as service, browser(tmp_path / "profile") as driver:
        page = Page(driver)
        driver.get(service.url + "/")
        page.wait_text("ready-title", "Ready")
        reached = set()
        for _ in range(25):
            ActionChains(driver).send_keys(Keys.TAB).perform()
            seen = driver.execute_script(
                "const e = document.activeElement; return [e.id || e.name || e.dataset.view || e.tagName,"
                " getComputedStyle(e).outlineStyle]"
            )
            reached.add(seen[0])
            assert seen[1] != "none" or seen[0] in ("BODY", "main"), seen
        assert {"cell", "work", "history", "upload", "mode", "axis", "prepare", "stop"} <= reached
        driver.execute_script("document.getElementById('prepare').focus()")
        ActionChains(driver).send_keys(Keys.ENTER).perform()
        page.shown("arm")
        # On from the headline: Enter pressed twice must not arm, and Tab need not begin at the top.
        page.wait_focus("run-title")
        ActionChains(driver).send_keys(Keys.ENTER, Keys.TAB, Keys.TAB).perform()
        page.wait_focus("arm")
        assert "Ready to move" in page.text("run-title")
