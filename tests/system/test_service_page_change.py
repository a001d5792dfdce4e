"""A tool change on the page: what changed comes first, in both languages, and the decision is in sight."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from page_browser import Page, browser, needs_browser
from service_process import SMALL_CELL, serving

pytestmark = [pytest.mark.campaign, pytest.mark.browser, pytest.mark.service, needs_browser]
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
TOOL = r"New load on A2: \+1\.\d+ ± 0\.\d+ kg·m² \(\+2[12] %\); looks like a tool change\. Accept\?"
WERKZEUG = (
    r"Neue Last an A2: \+1,\d+ ± 0,\d+ kg·m² \(\+2[12] %\); sieht nach einem Werkzeugwechsel aus\. Annehmen\?"
)


def on_screen(page: Page, identity: str) -> bool:
    """Whether all of it lies between the top and the stop bar, without scrolling."""
    script = """const box = (id) => document.getElementById(id).getBoundingClientRect();
      const b = box(arguments[0]);
      return window.scrollY === 0 && b.height > 0 && b.top >= 0 && b.bottom <= box('stopbar').top"""
    return bool(page.driver.execute_script(script, identity))


def outside_their_boxes(page: Page) -> list[str]:
    """Texts of the drawing that are wider than the box they stand in."""
    script = """const svg = document.querySelector('#drawing svg'), wrong = [];
      const boxes = [...svg.querySelectorAll('rect')].map((r) => r.getBBox());
      for (const text of svg.querySelectorAll('text')) {
        const t = text.getBBox(), x = t.x + t.width / 2, y = t.y + t.height / 2;
        const box = boxes.find((b) => x > b.x && x < b.x + b.width && y > b.y && y < b.y + b.height);
        if (box && (t.x < box.x || t.x + t.width > box.x + box.width)) wrong.push(text.textContent);
      }
      return [boxes.length, wrong]"""
    boxes, wrong = page.driver.execute_script(script)
    assert boxes == 4
    return list(wrong)


def invid(*arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "invid", *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_tool_change_is_the_headline_on_the_page_in_rest_and_at_the_command_line(tmp_path: Path) -> None:
    with serving(tmp_path, cell=TWO) as service, browser(tmp_path / "p") as driver:
        page = Page(driver)
        first = service.run_to_result()
        service.client.post(f"{first}/actions", json={"type": "accept"})
        heavier = {"payload": {"axis": "A2", "mass": 1.31}}
        answer = service.client.patch("/api/v1/cells/small/simulation", json=heavier)
        assert answer.status_code == 200, answer.text
        second = service.run_to_result()
        body = service.client.get(second).json()
        summary: dict[str, Any] = body["summary"]
        assert re.match(TOOL, summary["headline"]), summary["headline"]
        assert re.match(WERKZEUG, summary["headlines"]["de"]), summary["headlines"]
        assert summary["grade"] == "watch"
        assert body["untrusted"] is None
        (change,) = service.client.get(f"{second}/diagnosis").json()["changes"]
        # The truth of the plant judges, not the code under test.
        assert (change["kind"], change["axis"]) == ("load", "A2")
        assert abs(change["difference"] - 1.31) < 4 * change["std"]
        assert change["std"] < 0.1
        diagnosis = service.client.get(f"{second}/diagnosis").json()
        assert diagnosis["headline"] == summary["headline"]

        for width, height in ((800, 1280), (1280, 800)):
            page.resize(width, height)
            driver.get(service.url + "/")
            driver.refresh()
            page.drawing()
            assert re.match(TOOL, page.text("sentence"))
            assert "Watch" in page.text("grade")
            for part in ("grade", "sentence", "accept", "reject"):
                assert on_screen(page, part), (part, width)
            assert "consistent with a tool change" in page.shown("changes").text
            assert outside_their_boxes(page) == []
            assert page.overflow() <= 0
            driver.save_screenshot(str(tmp_path / f"change-{width}-en.png"))
        driver.add_cookie({"name": "invid-language", "value": "de", "path": "/"})
        for width, height in ((800, 1280), (1280, 800)):
            page.resize(width, height)
            driver.refresh()
            page.drawing()
            assert re.match(WERKZEUG, page.text("sentence"))
            for part in ("grade", "sentence", "accept", "reject"):
                assert on_screen(page, part), (part, width)
            assert "passt zu einem Werkzeugwechsel" in page.shown("changes").text
            assert outside_their_boxes(page) == []
            driver.save_screenshot(str(tmp_path / f"change-{width}-de.png"))
        assert page.barriers() == []

        failed = service.start(arm=False)
        service.wait(failed, "awaiting_arm")
        service.client.post(f"{failed}/actions", json={"type": "cancel"})
        service.wait(failed, "cancelled")
        page.resize(800, 1280)
        driver.execute_script("window.scrollTo(0, 0)")
        driver.find_element("css selector", "[data-view=history]").click()
        page.wait_text("runs", "Werkzeugwechsel")
        page.wait_text("runs", "Auf Wunsch abgebrochen")
        assert page.overflow() <= 0
        cut = driver.execute_script(
            "return [...document.querySelectorAll('#view-history .scroll')]"
            ".map((b) => b.scrollWidth - b.clientWidth)"
        )
        assert max(cut) <= 1
        said = page.text("view-history")
        for english in ("accepted", "cancelled", "looks like", "result", "compare"):
            assert english not in said.lower()
        driver.save_screenshot(str(tmp_path / "history-800-de.png"))
        page.resize(800, 1280)
        files = {name: tmp_path / name for name in ("old.json", "new.json", "new.h5", "d.json")}
        files["old.json"].write_bytes(service.client.get(f"{first}/model").content)
        files["new.json"].write_bytes(service.client.get(f"{second}/model").content)
        files["new.h5"].write_bytes(service.client.get(f"{second}/recording").content)
    old, new, recording, out = (str(files[n]) for n in ("old.json", "new.json", "new.h5", "d.json"))
    assert re.match(TOOL, invid("compare", old, new))
    german = invid("compare", old, new, "--language", "de")
    assert re.match(WERKZEUG, german)
    assert "A2: letzte Masse" in german
    assert re.match(WERKZEUG, invid("diagnose", recording, "--model", old, "--language", "de", "-o", out))
    document = json.loads(files["d.json"].read_text(encoding="utf-8"))
    assert re.match(TOOL, document["headline"])
    assert document["grade"] == "watch"


def test_the_weightiest_doubt_is_the_reason_and_not_the_first_warning(tmp_path: Path) -> None:
    with serving(tmp_path, cell=TWO) as service, browser(tmp_path / "p", language="de") as driver:
        page = Page(driver)
        page.resize(1280, 800)
        location = service.run_to_result(mode="test")
        body = service.client.get(location).json()
        assert [d["code"] for d in body["summary"]["doubts"]][-1] == "test"
        driver.get(service.url + "/")
        assert "mit den kleinen Momenten einer Probe" in page.shown("untrusted").text
        assert "nicht zu trauen" not in page.text("sentence"), "nothing speaks against the model itself"
        assert on_screen(page, "accept")
        driver.save_screenshot(str(tmp_path / "doubt-1280-de.png"))
