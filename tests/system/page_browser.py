"""Headless Chromium and what a person does with the page."""

import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
needs_browser = pytest.mark.skipif(
    not (BROWSER and DRIVER),
    reason="CHROMIUM IS MISSING: the page is not tested; apt-get install chromium-driver",
)
AXE = Path(__file__).parent / "vendor" / "axe.min.js"
"""axe-core 4.10.3 (npm), for tests only."""
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
def browser(profile: Path, width: int = 1280, height: int = 900, language: str = "en") -> Iterator[Any]:
    """A fresh Chromium that asks for pages in ``language``."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    for flag in [*FLAGS, f"--user-data-dir={profile}", f"--window-size={width},{height}"]:
        options.add_argument(flag)
    options.add_argument(f"--lang={language}")
    options.add_experimental_option("prefs", {"intl.accept_languages": language})
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
        """A click in the middle of the screen, where the stop bar does not lie over it, once it stands still:
        what comes late on a busy machine moves it from under the pointer."""
        place, deadline = None, time.monotonic() + 10.0
        while time.monotonic() < deadline:
            self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
            before, place = place, element.rect
            if place == before:
                break
            time.sleep(0.2)
        element.click()

    def unfold(self, identity: str) -> None:
        """Open a fold that is there."""
        self.press(self.shown(identity).find_element("tag name", "summary"))

    def text(self, identity: str) -> str:
        """What stands there now; nothing while the page is loaded anew."""
        from selenium.common.exceptions import NoSuchElementException, StaleElementReferenceException

        try:
            return str(self.driver.find_element("id", identity).text)
        except (NoSuchElementException, StaleElementReferenceException):
            return ""

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

    def resize(self, width: int, height: int) -> None:
        """The size of the page itself, without the browser's frame."""
        self.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
        )
        time.sleep(0.5)

    def shown_as(self, scheme: str = "light", media: str = "screen") -> None:
        """Light or dark, on the screen or printed."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media, "features": features})
        time.sleep(0.3)

    def barriers(self) -> list[str]:
        """What axe-core finds against people who cannot see, hear or point: rule and elements."""
        if not self.driver.execute_script("return 'axe' in window"):
            self.driver.execute_script(AXE.read_text(encoding="utf-8"))
        found = self.driver.execute_async_script(
            "const done = arguments[arguments.length - 1];"
            " axe.run().then((r) => done(JSON.stringify(r.violations.map((v) =>"
            " `${v.id}: ${v.nodes.slice(0, 3).map((n) => n.html.slice(0, 160)).join(' | ')}`))))"
        )
        return list(json.loads(found))

    def nameless_pictures(self) -> list[str]:
        """Pictures on the screen that say nothing to whoever cannot see them."""
        script = """const desc = (p) => p.querySelector('desc')?.textContent ?? '';
          const said = (p) => p.getAttribute('aria-label') || desc(p);
          return [...document.querySelectorAll('svg, canvas')].filter((e) => e.getClientRects().length)
            .filter((e) => { const p = e.closest('[role=img]'); return !p || !/[0-9]/.test(said(p)); })
            .map((e) => e.outerHTML.slice(0, 200))"""
        return list(self.driver.execute_script(script))

    def overflow(self) -> int:
        """Pixels by which the page is wider than its window."""
        script = "return document.documentElement.scrollWidth - document.documentElement.clientWidth"
        return int(self.driver.execute_script(script))

    def mistakes(self) -> list[str]:
        """Errors in the browser's log (a 404 on purpose is none)."""
        return [e["message"] for e in self.driver.get_log("browser") if e["level"] == "SEVERE"]


@contextmanager
def looking(folder: Path, service: Any, *size: int, language: str = "en", at: str = "/") -> Iterator[Page]:
    """The page of a service that is served, ``size`` wide and high where that is given."""
    with browser(folder / "profile", language=language) as driver:
        page = Page(driver)
        if size:
            page.resize(*size)
        driver.get(service.url + at)
        yield page
