"""The page at the moments that count: what is wrong, does it matter, where, what now; for whom."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path
from typing import Any

import pytest
from page_browser import Page, browser, needs_browser
from service_process import SMALL_CELL, STIFF_CELL, serving
from test_service_next_step import progress_of

TEXTS = Path(__file__).parents[2] / "service/invid_service/web/static/texts/en.json"
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


def test_a_test_result_does_not_invite_and_is_accepted_for_a_reason(tmp_path: Path) -> None:
    with serving(tmp_path) as service, browser(tmp_path / "profile") as driver:
        page = Page(driver)
        location = service.run_to_result(mode="test")
        driver.get(service.url + "/")
        accept = page.shown("accept")
        assert "primary" not in (accept.get_attribute("class") or "")
        assert "small torques" in page.shown("untrusted").text
        page.press(accept)
        question = driver.find_element("css selector", "form.ask")
        assert "small torques" in question.text
        assert page.barriers() == []
        yes = question.find_element("css selector", "[type=submit]")
        assert not yes.is_enabled()
        question.find_element("tag name", "input").send_keys("only to see whether it turns")
        assert not page.stop_covered()
        page.press(yes)
        page.wait_text("decision", "only to see whether it turns")
        assert service.client.get(location).json()["decision"]["override"] == "only to see whether it turns"


def test_the_page_speaks_german_to_a_german_browser_and_english_when_told_to(tmp_path: Path) -> None:
    from selenium.webdriver.support.ui import Select

    with serving(tmp_path, cell=STIFF_CELL) as service, browser(tmp_path / "p", language="de") as driver:
        page = Page(driver)
        page.resize(800, 1280)
        driver.get(service.url + "/")
        page.wait_text("ready-title", "Bereit zum Messen")
        assert driver.execute_script("return document.documentElement.lang") == "de"
        page.press(page.shown("prepare"))
        page.shown("arm")
        page.wait_text("plan-table", "Moment bis")
        page.press(driver.find_element("id", "arm"))
        page.wait_text("run-title", "Es wird gemessen")
        assert not driver.find_element("id", "language").is_enabled(), "the stop button stays while it moves"
        page.shown("accept", 120)
        page.wait_text("sentence", "Trockene Reibung an A1, 2 % des Nennmoments: wie erwartet, nichts zu tun")
        page.wait_text("grade", "Wie erwartet")
        assert "Last" in page.drawing().text
        said = re.search(r"trockene Reibung, (\d+,\d+) ± ", page.drawing().text)
        assert said is not None
        assert abs(float(said[1].replace(",", ".")) - 1.0) < 0.05
        assert "des Nennmoments" in page.text("findings")
        assert on_screen(page, "accept")
        assert page.barriers() == []
        Select(driver.find_element("id", "language")).select_by_value("en")
        page.wait_text("sentence", "Dry friction on A1")
        assert driver.execute_script("return document.documentElement.lang") == "en"
        page.shown("accept")
        assert page.mistakes() == []


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


def test_the_separating_measurement_is_a_button_that_shows_first_what_it_moves(
    finished: str, tmp_path: Path
) -> None:
    separating = {"finding": 0, "text": "slow moves in both directions"}
    with serving(tmp_path, cell=STIFF_CELL) as service, browser(tmp_path / "profile", 800, 1280) as driver:
        answering(driver, separating={"is": separating, "states": ["awaiting_accept"]})
        page = Page(driver)
        driver.get(service.url + "/")
        page.drawing()  # one that comes late, on a busy machine, moves the button from under the pointer
        assert "Slow moves in both directions" in page.shown("separate-card").text
        page.press(page.shown("separate"))
        page.wait_text("run-title", "Ready to move")
        assert "A1" in page.text("plan-table")
        asked = driver.execute_script("return window.asked")
        assert asked[-1] == {"mode": "full", "separate": finished.rsplit("/", 1)[1]}
        page.press(page.shown("cancel"))


def test_the_history_draws_every_number_with_its_band_and_the_overview_shows_every_cell(
    finished: str, tmp_path: Path
) -> None:
    other = tmp_path / "other.yaml"
    # hardware that nobody answers for, and a load of which nobody has seen how it is held
    bus = f"{{interface: invid-unix, channel: {tmp_path}/nobody.sock, cycle_s: 0.002}}"
    loaded = SMALL_CELL.replace("gravity_loaded: false", "gravity_loaded: true").split("simulation:")[0]
    loaded = loaded.replace("{interface: invid-virtual, channel: small, cycle_s: 0.001}", bus)
    other.write_text(loaded.replace("small cell", "other cell"))
    with serving(tmp_path, str(other), cell=STIFF_CELL) as service, browser(tmp_path / "profile") as driver:
        page = Page(driver)
        page.resize(800, 1280)
        service.client.post(f"{finished}/actions", json={"type": "accept"})
        service.run_to_result()  # not accepted
        driver.get(service.url + "/")
        page.shown("accept")
        driver.execute_script("window.scrollTo(0, 0)")
        driver.find_element("css selector", "[data-view=history]").click()
        page.shown("charts")
        page.wait_text("charts", "Causes")
        for fold in driver.find_elements("css selector", "#charts summary"):
            page.press(fold)
        page.wait_text("charts", "A1: dry friction at the motor")
        expected = {"A1.mass.1", "A1.mass.2", "A1.spring.1", "A1.damper.1", "A1.coulomb_friction.mass 1"}
        names = "return [...document.querySelectorAll('#charts figure')].map((f) => f.dataset.parameter)"
        deadline = time.monotonic() + 30
        chance = {"A1.stribeck_friction.mass 1"}  # one run in a hundred
        while (drawn := set(driver.execute_script(names))) - chance != expected:  # each is fetched for itself
            assert time.monotonic() < deadline, drawn
            time.sleep(0.1)
        one = driver.find_element("css selector", "[data-parameter='A1.spring.1'] svg")
        assert "2 models" in one.get_attribute("aria-label")
        assert one.find_elements("css selector", ".band")
        assert len(one.find_elements("css selector", ".accepted")) == 1
        assert len(one.find_elements("css selector", ".other")) == 1
        link = driver.find_element("css selector", "[data-parameter='A1.spring.1'] a").get_attribute("href")
        assert service.client.get("/api/v1" + link.split(service.url)[-1]).text.startswith("created,model")
        driver.execute_script("window.scrollTo(0, 0)")
        driver.find_element("css selector", "[data-view=overview]").click()
        page.wait_text("fleet", "never measured")
        rows = {
            r.get_attribute("data-cell"): r for r in driver.find_elements("css selector", "#fleet-rows tr")
        }
        assert set(rows) == {"small", "other"}
        assert "unchanged" in rows["small"].text
        assert "As expected" in rows["small"].text
        assert "never measured" in rows["other"].text
        page.press(rows["other"].find_element("tag name", "button"))
        page.wait_text("ready-title", "Ready")
        assert driver.find_element("id", "cell").get_attribute("value") == "other"
        deadline = time.monotonic() + 30
        while driver.find_element("id", "simulated").is_displayed():  # the cell before is still shown
            assert time.monotonic() < deadline
            time.sleep(0.1)
        page.press(page.shown("prepare"))
        page.wait_text("run-title", "Ready to move")
        assert "Where A1 carries a load, support it" in page.shown("support").text
        assert "nobody is within reach" in page.text("plan-facts")
        page.press(page.shown("cancel"))
        assert page.mistakes() == []


def test_the_analysis_says_what_it_does_and_that_it_still_looks(tmp_path: Path) -> None:
    with serving(tmp_path, cell=STIFF_CELL) as service, browser(tmp_path / "profile") as driver:
        page = Page(driver)
        driver.get(service.url + "/")
        page.wait_text("ready-title", "Ready")
        # Some stages last less than a look at them from outside takes.
        driver.execute_script(
            "window.said = new Set(); const box = document.getElementById('phase');"
            " new MutationObserver(() => said.add(box.textContent)).observe("
            "box, { childList: true, characterData: true, subtree: true })"
        )
        location = service.start()
        page.wait_text("run-title", "Analysing")
        deadline = time.monotonic() + 90
        while driver.find_element("id", "progress").is_displayed() and time.monotonic() < deadline:
            time.sleep(0.1)
        seen = driver.execute_script("return [...said].filter((text) => text)")
        said = " ".join(seen)
        assert "identifying" not in said, "words for a person"
        # A stage that is over before the page looks is not seen: how long it lasts is the machine's. Each is
        # told, and has words of its own.
        told = [event["phase"] for event in progress_of(service, location)]
        assert any(phase.startswith("identifying") for phase in told), told
        words = json.loads(TEXTS.read_text(encoding="utf-8"))
        assert words["phase.identifying"] == "finding masses, springs and dampers"
        assert "looking for what the model lacks" in said or "weighing" in said
        assert len(seen) > 2
