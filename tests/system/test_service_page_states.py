"""Every state of a cell at a desk and on a phone: its one action lies in view, in one language."""

import os
import re
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from page_browser import Page, browser, needs_browser
from service_process import SMALL_CELL, STIFF_CELL, Serving, serving

from invid_drivers.cia402.journal import journal_path
from invid_drivers.cia402.standing.hold_memory import HoldMemory, Seen
from invid_drivers.simulated.unix_bus import UnixHub

pytestmark = [
    pytest.mark.browser,
    pytest.mark.service,
    pytest.mark.campaign,
    pytest.mark.timeout(900),
    needs_browser,
]
SIZES = ((1280, 800), (768, 1024), (390, 844))
# Nothing is kept for validation, which is said before arming and with the result; without friction nothing
# has to be searched for.
SHORT = re.sub(r"  - \{kind: multisine, role: validate.*\n", "", SMALL_CELL)
LONG = SHORT.replace("periods: 3}", "periods: 120}").replace("small", "long")
TWO_PERIODS = 2 / 120
ABSENT = SHORT.replace("small", "absent").replace("invid-virtual", "socketcan")
WORDS = "the|and|of|is|are|it|with|for|that|its|this|from|to|axis|torque|record"
ENGLISH = re.compile(rf"\b({WORDS})\b", re.IGNORECASE)
"""Words that no German sentence has."""
CITATION = re.compile(r"\([^()]*\b(?:19|20)\d\d\b[^()]*\)")
"""Who found it stays as it is."""
IN_VIEW = """const b = document.getElementById(arguments[0]).getBoundingClientRect();
  const over = document.elementFromPoint(b.x + b.width / 2, b.y + b.height / 2);
  const bar = document.getElementById('stopbar').getBoundingClientRect();
  const end = arguments[0] === 'stop' ? innerHeight : bar.top;
  return b.height > 0 && b.top >= 0 && b.bottom <= end && b.left >= 0 && b.right <= innerWidth
    && over?.closest('button')?.id === arguments[0];"""


class Looking(Page):
    """Looks at a state: in every size, with everything unfolded in the end."""

    def __init__(self, driver: Any, folder: Path, language: str) -> None:
        super().__init__(driver)
        self.folder, self.language = Path(os.environ.get("INVID_PICTURES", folder)), language
        self.english = set[str]()

    def action(self, state: str, *buttons: str) -> None:
        for width, height in SIZES:
            self.resize(width, height)
            self.driver.execute_script("window.scrollTo(0, 0)")
            self.driver.save_screenshot(str(self.folder / f"{self.language}-{state}-{width}.png"))
            for button in buttons:
                assert self.driver.execute_script(IN_VIEW, button), (
                    f"{state}: #{button} at {width} x {height}"
                )
            assert not self.stop_covered(), state
            assert self.overflow() <= 0, state
        self.resize(*SIZES[0])

    def reads(self, state: str) -> None:
        if self.language == "en":
            return
        unfold = "for (const d of document.querySelectorAll('details')) d.open = true;"
        text = str(self.driver.execute_script(f"{unfold} return document.body.innerText"))
        for line in text.splitlines():
            if ENGLISH.search(CITATION.sub("", line)):
                self.english.add(f"{state}: {line}")

    def view(self, name: str) -> None:
        self.driver.execute_script("window.scrollTo(0, 0)")
        self.driver.find_element("css selector", f"[data-view={name}]").click()
        self.shown(f"view-{name}")
        time.sleep(1.0)


@pytest.mark.parametrize("language", ["de", "en"])
def test_the_one_action_of_every_state_lies_in_view_and_is_said_in_one_language(
    tmp_path: Path, language: str
) -> None:
    configs = []
    for name, cell in (("short", SHORT), ("long", LONG), ("absent", ABSENT)):
        configs.append(str(tmp_path / f"{name}.yaml"))
        Path(configs[-1]).write_text(cell)
    with (
        serving(tmp_path, *configs, cell=None) as service,
        browser(tmp_path / "profile", language=language) as driver,
    ):
        page = Looking(driver, tmp_path, language)
        page.resize(*SIZES[0])
        driver.get(service.url + "/")
        _choose(page, "absent")
        page.shown("reasons")
        page.action("refused")
        assert driver.execute_script(
            "return document.getElementById('reasons').getBoundingClientRect().bottom"
            " <= document.getElementById('stopbar').getBoundingClientRect().top"
        )
        page.reads("refused")
        _choose(page, "long")
        page.action("ready", "prepare")
        page.reads("ready")
        page.press(page.shown("prepare"))
        page.shown("arm")
        page.action("awaiting arm", "arm", "cancel")
        assert page.text("plan-warnings"), "something is to be read before arming"
        page.reads("awaiting arm")
        page.press(page.shown("arm"))
        page.shown("progress")
        location = _started(service, "long")
        service.wait_for_motion(location, share=TWO_PERIODS)
        page.action("running", "stop", "cancel")
        page.reads("running")
        page.shown("stop").click()
        service.wait(location, "stopped", timeout=20)
        page.shown("stopped-do")
        page.action("stopped", "stopped-do", "retry")
        said = {"de": "Auf Wunsch angehalten", "en": "Stopped on request"}[language]
        assert page.text("run-error").count(said) == 1
        page.reads("stopped")
        page.press(page.shown("retry"))
        page.press(page.shown("prepare"))
        page.press(page.shown("cancel"))
        page.shown("retry")
        assert not driver.find_element("id", "analyse").is_displayed(), "nothing was recorded"
        page.action("cancelled", "retry")
        page.reads("cancelled")
        page.press(page.shown("retry"))
        location = service.start("long")
        service.wait_for_motion(location, share=TWO_PERIODS)
        for runner in service.runners():
            os.kill(runner, signal.SIGKILL)
        service.wait(location, "failed", timeout=20)
        page.shown("retry")
        page.action("failed", "retry")
        page.reads("failed")
        _choose(page, "short")
        location = service.start("short")
        service.wait(location, "analysing")
        page.shown("progress")
        page.action("analysing", "cancel")
        page.reads("analysing")
        page.shown("accept", 300)
        page.drawing()
        page.action("awaiting accept", "accept", "reject")
        page.shown("numbers")
        page.reads("awaiting accept")
        page.press(page.shown("accept"))
        page.shown("again")
        page.action("succeeded", "again")
        page.reads("succeeded")
        page.press(page.shown("again"))
        location = service.start("short", mode="test")
        page.shown("untrusted", 300)
        page.drawing()
        page.action("not to be trusted", "accept", "reject")
        page.reads("not to be trusted")
        for view in ("history", "overview", "upload"):
            page.view(view)
            page.action(view)
            page.reads(view)
        assert page.english == set()
        assert page.mistakes() == []


def test_what_was_found_is_said_in_german_alone(finished: str, tmp_path: Path) -> None:
    with (
        serving(tmp_path, cell=STIFF_CELL) as service,
        browser(tmp_path / "profile", language="de") as driver,
    ):
        page = Looking(driver, tmp_path, "de")
        driver.get(service.url + "/")
        page.drawing()
        page.action("found", "accept", "reject")
        page.shown("numbers")
        page.reads("found")
        assert "Reibung" in page.text("sentence")
        assert page.english == set()


def _choose(page: Looking, cell: str) -> None:
    from selenium.webdriver.support.ui import Select

    page.driver.execute_script("window.scrollTo(0, 0)")
    deadline = time.monotonic() + 30
    while not page.driver.find_elements("css selector", f"#cell option[value={cell}]"):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    Select(page.driver.find_element("id", "cell")).select_by_value(cell)
    page.shown("ready-card")
    time.sleep(1.0)


def _started(service: Serving, cell: str) -> str:
    runs = service.client.get("/api/v1/identifications", params={"cell": cell}).json()["identifications"]
    return str(runs[0]["links"]["self"])


def test_what_is_remembered_of_the_axes_is_asked_of_the_drives_by_one_button(tmp_path: Path) -> None:
    """Nobody answers on the bus: the page says that, and goes on saying what it remembers."""
    wire = tmp_path / "wire.sock"
    hub = UnixHub(str(wire))
    state = tmp_path / "state" / "invid"
    text = SMALL_CELL.split("simulation:")[0].replace(
        "invid-virtual, channel: small", f"invid-unix, channel: {wire}"
    )
    name = journal_path("invid-unix", str(wire)).with_suffix(".holds.json").name
    HoldMemory(state / name).keep("a drive", Seen(1, loaded=True, holds=True, resumes=True, left_held=True))
    try:
        with (
            serving(tmp_path, cell=text, env={"XDG_STATE_HOME": str(tmp_path / "state")}) as service,
            browser(tmp_path / "profile") as driver,
        ):
            page = Page(driver)
            driver.get(service.url + "/")
            page.wait_text("ready-notes", "Axis A1 (node 1) is energised")
            page.press(page.shown("check"))
            page.wait_text("reasons", "does not answer", 60.0)
            assert "Axis A1 (node 1) is energised" in page.text("ready-notes")
    finally:
        hub.shutdown()
