"""A person accepts by name, says what was changed, and a short check on the page answers that first."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from page_browser import Page, browser, needs_browser
from service_process import SMALL_CELL, serving

pytestmark = [pytest.mark.browser, pytest.mark.service, pytest.mark.campaign, needs_browser]
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


def on_screen(page: Page, identity: str) -> bool:
    """Whether all of it lies between the top and the stop bar, without scrolling."""
    script = """const box = (id) => document.getElementById(id).getBoundingClientRect();
      const b = box(arguments[0]);
      return window.scrollY === 0 && b.height > 0 && b.top >= 0 && b.bottom <= box('stopbar').top"""
    return bool(page.driver.execute_script(script, identity))


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
