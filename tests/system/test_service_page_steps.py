"""The page at the moments that count: what is wrong, does it matter, where, what now; for whom."""

import time
from pathlib import Path

import pytest
from page_browser import Page, browser, looking, needs_browser
from service_process import SMALL_CELL, STIFF_CELL, serving

pytestmark = [pytest.mark.campaign, pytest.mark.browser, pytest.mark.service, needs_browser]


def on_screen(page: Page, identity: str) -> bool:
    """Whether all of it lies between the top and the stop bar, without scrolling."""
    script = """const box = (id) => document.getElementById(id).getBoundingClientRect();
      const b = box(arguments[0]);
      return window.scrollY === 0 && b.height > 0 && b.top >= 0 && b.bottom <= box('stopbar').top"""
    return bool(page.driver.execute_script(script, identity))


def test_the_first_screen_of_a_tablet_holds_headline_grade_drawing_and_decision(
    finished: str, tmp_path: Path
) -> None:
    with serving(tmp_path, cell=STIFF_CELL) as service, looking(tmp_path, service, 800, 1280) as page:
        assert "mass 1" not in page.drawing().text
        for part in ("grade", "sentence", "where", "accept", "reject"):
            assert on_screen(page, part), part
        assert not page.driver.find_element("id", "parameters").is_displayed()
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
        page.shown_as("light", "print")
        head = page.shown("print-head").text
        for known in (finished.rsplit("/", 1)[1], "Started by local", "invid 0"):
            assert known in head
        assert not page.driver.find_element("id", "stop").is_displayed()
        page.shown_as("light")
        page.driver.execute_script("window.dispatchEvent(new Event('beforeprint'))")
        assert page.driver.find_element("id", "parameters").is_displayed(), "paper cannot be unfolded"
        page.driver.execute_script("window.dispatchEvent(new Event('afterprint'))")
        assert not page.driver.find_element("id", "parameters").is_displayed()
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


AXIS = """  - name: A2
    node_id: 2
    rated_torque_Nm: 80
    masses: 2
    inertia_kgm2: 7.0
    gravity_loaded: false
    limits: {torque_Nm: 40, position_window_rad: 1.0, velocity_rad_per_s: 5, stopping_room_rad: 3}
safety:"""
TWO = SMALL_CELL.replace("safety:", AXIS, 1).replace(
    "dampers_Nms_per_rad: [1.0]}]",
    "dampers_Nms_per_rad: [1.0]}, {axis: A2, masses_kgm2: [1.5, 5.97], springs_Nm_per_rad: [4000],"
    " dampers_Nms_per_rad: [3.0]}]",
)


def test_a_named_person_accepts_says_what_changed_and_a_short_check_answers_it(tmp_path: Path) -> None:
    with serving(tmp_path, cell=TWO) as service, browser(tmp_path / "p") as driver:
        page = Page(driver)
        page.resize(390, 844)
        first = service.run_to_result()
        driver.get(service.url + "/")
        page.drawing()
        assert on_screen(page, "accept")
        page.shown("by").send_keys("Ann Weld")
        page.press(page.shown("accept"))
        page.wait_text("decision", "Model accepted by Ann Weld.")
        history = service.client.get("/api/v1/cells/small/models").json()["history"]
        assert [h["by"] for h in history] == ["Ann Weld"]
        service.client.patch("/api/v1/cells/small/simulation", json={"payload": {"axis": "A2", "mass": 1.31}})

        page.press(page.shown("again"))
        page.wait_text("in-force", "Ann Weld")
        page.unfold("changed")
        assert not page.driver.find_element("id", "changed-mass").is_displayed()
        page.press(driver.find_element("css selector", "#changed label:has([value=tool])"))
        driver.find_element("css selector", "#changed-axis [value=A2]").click()
        for field, value in (("changed-mass", "1.3"), ("changed-arm", "1")):
            page.shown(field).send_keys(value)
        assert page.overflow() <= 0
        assert page.small_targets() == []
        page.press(page.shown("screen"))
        page.press(page.shown("arm"))
        page.drawing()
        assert page.text("sentence").startswith("As you said, new load on A2: +1.3")
        assert page.text("sentence").endswith("Measure in full to take it over.")
        assert "Said before: Tool, A2, 1.3 kg, 1 m" in page.text("run-facts")
        assert not driver.find_element("id", "accept").is_displayed()
        now = service.client.get("/api/v1/cells/small/model").json()["id"]
        assert first.endswith(now), "a short check replaces no model"

        page.press(page.shown("again"))
        page.shown("start-card")
        assert not driver.find_element("id", "changed-mass").is_displayed(), "said once, for one run"
        driver.refresh()
        time.sleep(0.5)
        assert driver.execute_script("return document.getElementById('by').value") == "Ann Weld"
        assert page.barriers() == []
        assert page.mistakes() == []
