"""The page when something happens that it did not do itself: stops, restarts, silence, runs of others."""

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from page_browser import Page, looking, needs_browser
from service_process import SMALL_CELL, Serving, serving

from invid_service.keys import add_key, revoke_key

pytestmark = [pytest.mark.browser, pytest.mark.service, needs_browser]
LONG = SMALL_CELL.replace("periods: 3}", "periods: 120}")


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Serving, Page]]:
    """A service and its page, on which one run after another is stopped."""
    folder = tmp_path_factory.mktemp("opened")
    with serving(folder, cell=LONG) as service, looking(folder, service, 800, 1280) as page:
        yield service, page


def view(page: Page, name: str) -> None:
    page.driver.find_element("css selector", f"[data-view={name}]").click()


@pytest.mark.campaign
def test_stop_in_the_overview_stops_the_cell_that_moves_and_says_which(tmp_path: Path) -> None:
    other = tmp_path / "other.yaml"
    other.write_text(LONG.replace("small cell", "robot 02").replace("channel: small", "channel: two"))
    with serving(tmp_path, str(other), cell=LONG) as service, looking(tmp_path, service, 800, 1280) as page:
        page.wait_text("stop", "small cell")
        location = service.start("other")
        page.wait_text("moving", "robot 02")
        # The button stops what stands on it, and says so; the other one is named.
        page.shown("stop").click()
        page.wait_text("stop-note", "small cell: nothing was moving")
        assert "robot 02: Measuring" in page.text("moving")
        view(page, "overview")
        page.wait_text("counts", "1 moving")
        assert "1 ready" in page.text("counts")
        rows = page.driver.find_elements("css selector", "#fleet-rows tr")
        assert [r.get_attribute("data-cell") for r in rows] == ["other", "small"], "worst first"
        assert "all cells" in page.text("stop")
        assert page.small_targets() == []
        assert page.barriers() == []
        page.shown("stop").click()
        service.wait(location, "stopped", timeout=10)
        page.wait_text("stop-note", "robot 02: stopped")
        page.wait_text("counts", "1 to look at")
        row = page.driver.find_element("css selector", "[data-cell=other]")
        assert "Stopped" in row.text, "not green after a stop"
        # One button a row.
        location = service.start("other")
        page.wait_text("counts", "1 moving")
        row.find_element("css selector", "button.stop").click()
        service.wait(location, "stopped", timeout=10)
        assert page.mistakes() == []


def test_a_stop_works_with_a_revoked_key_and_nothing_covers_it(tmp_path: Path) -> None:
    keys = tmp_path / "keys.json"
    mine, plc = add_key(keys, "tablet", ["read", "run", "accept"]), add_key(keys, "plc", ["read", "run"])
    with (
        serving(tmp_path, "--key-file", str(keys), cell=LONG) as service,
        looking(tmp_path, service, 800, 1280) as page,
    ):
        service.client.headers["Authorization"] = f"Bearer {plc}"
        page.wait_text("notices", "asks for a key")
        page.driver.find_element("css selector", "form.ask input").send_keys(mine)
        page.driver.find_element("css selector", "form.ask button").click()
        page.wait_text("ready-title", "Ready")
        revoke_key(keys, "tablet")
        page.wait_text("notices", "The key is not valid")
        page.wait_text("offline", "nothing is known")
        for width, height in ((800, 1280), (1280, 800), (390, 700)):
            page.resize(width, height)
            assert not page.stop_covered(), width
        page.resize(800, 1280)
        assert page.barriers() == []
        location = service.start("small")
        service.wait_for_motion(location, share=0.0)
        page.shown("stop").click()
        service.wait(location, "stopped", timeout=10)
        page.wait_text("stop-note", "small cell: stopped")


def test_the_stop_button_and_the_escape_key_stop_the_robot_at_once(opened: tuple[Serving, Page]) -> None:
    from selenium.webdriver.common.keys import Keys

    service, page = opened
    page.wait_text("stop", "small cell")  # before the page knows its cells, it stops all of them
    page.shown("stop").click()
    page.wait_text("stop-note", "small cell: nothing was moving")
    location = service.start()
    page.wait_text("run-title", "Measuring")
    began = time.monotonic()
    page.driver.find_element("tag name", "body").send_keys(Keys.ESCAPE)
    page.wait_text("stop-note", "Stopping small cell")
    service.wait(location, "stopped", timeout=10)
    assert time.monotonic() - began < 5
    page.wait_text("stop-note", "small cell: stopped")
    page.wait_text("run-title", "Stopped")
    # Beside where it stopped; before it had moved there is no such place, and it follows the reason.
    assert "What to do" in page.text("run-card")


def test_a_stop_that_could_not_be_sent_is_sent_when_the_service_is_back(
    opened: tuple[Serving, Page],
) -> None:
    service, page = opened
    location = service.start("small")
    page.wait_text("run-title", "Measuring")
    offline = {"offline": True, "latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
    page.driver.execute_cdp_cmd("Network.enable", {})
    page.driver.execute_cdp_cmd("Network.emulateNetworkConditions", offline)
    page.shown("stop").click()
    page.wait_text("stop-note", "STOP NOT CONFIRMED")
    assert "USE THE EMERGENCY STOP" in page.text("stop-note")
    page.wait_text("offline", "nothing is known of any cell")
    assert service.client.get(location).json()["state"] == "running"
    page.driver.execute_cdp_cmd("Network.emulateNetworkConditions", {**offline, "offline": False})
    service.wait(location, "stopped", timeout=10)
    page.wait_text("stop-note", "small cell: stopped")
    assert "NOT CONFIRMED" not in page.text("stop-note")
    page.wait_text("run-title", "Stopped")
    assert not page.driver.find_element("id", "offline").is_displayed()


@pytest.mark.campaign
def test_a_service_that_is_silent_is_said_after_five_seconds_and_the_time_left_stops(tmp_path: Path) -> None:
    with serving(tmp_path, cell=LONG) as service, looking(tmp_path, service, 800, 1280) as page:
        service.start("small")
        page.wait_text("phase", "left")
        os.kill(service.process.pid, signal.SIGSTOP)
        try:
            began = time.monotonic()
            page.wait_text("offline", "nothing is known of any cell")
            assert 4 < time.monotonic() - began < 8
            page.wait_text("run-title", "Not known. At ")
            frozen = page.text("phase")
            assert "left" not in frozen
            assert not page.driver.find_element("id", "cancel").is_enabled()
            page.shown("stop").click()
            page.wait_text("stop-note", "STOP NOT CONFIRMED")
            assert page.text("phase") == frozen
            assert page.barriers() == []
        finally:
            os.kill(service.process.pid, signal.SIGCONT)
        page.wait_text("stop-note", "small cell: stopped")
        page.wait_text("run-title", "Stopped")


@pytest.mark.campaign
def test_after_a_restart_in_mid_run_the_page_says_interrupted(tmp_path: Path) -> None:
    with serving(tmp_path, cell=LONG) as service, looking(tmp_path, service, 800, 1280) as page:
        location = service.start("small")
        page.wait_text("run-title", "Measuring")
        # The first experiment has begun, so that there is something to analyse.
        while service.client.get(location).json()["progress"] < 0.6:
            time.sleep(0.05)
        port = service.url.rsplit(":", 1)[1]
        service.kill()
        began = time.monotonic()
        with serving(tmp_path, "--port", port, cell=LONG) as second:
            up = time.monotonic()
            page.wait_text("run-title", "Interrupted by a restart", 3.0)
            assert not page.driver.find_element("id", "progress").is_displayed()
            assert second.url == service.url
            page.press(page.shown("analyse"))
            assert "A1" in page.shown("sentence").text
            page.press(page.shown("again"))
            page.wait_text("ready-title", "Ready")
        assert up - began < 60
