"""What now, on a real service with its real runner: half the torque, a stop, what separates two causes."""

import json
from pathlib import Path
from typing import Any

import pytest
from service_process import SMALL_CELL, Serving, serving

pytestmark = pytest.mark.service

STUCK = """\
  faults:
    - {kind: encoder_stuck, axis: A1, at_state: operation_enabled, after_s: 22}
"""


def progress_of(service: Serving, location: str) -> list[dict[str, Any]]:
    """The data of every progress event up to the result."""
    found, kind = [], ""
    with service.client.stream("GET", f"{location}/events") as stream:
        for line in stream.iter_lines():
            if line.startswith("event: "):
                kind = line[7:]
            elif line.startswith("data: "):
                data = json.loads(line[6:])
                if kind == "progress":
                    found.append(data)
                if data.get("state") == "awaiting_accept":
                    break
    return found


@pytest.mark.campaign
def test_gentler_shakes_with_half_of_the_torque_and_the_analysis_tells_its_time_left(tmp_path: Path) -> None:
    with serving(tmp_path) as service:
        peaks = {}
        for amplitude in ("planned", "gentler"):
            location = service.start(arm=False, amplitude=amplitude)
            plan = service.wait(location, "awaiting_arm")["plan"]
            assert plan["amplitude"] == amplitude
            service.client.post(f"{location}/actions", json={"type": "arm"})
            peaks[amplitude] = service.wait(location, "awaiting_accept")["measurement"]["peaks"]["A1"]
            told = progress_of(service, location)
            service.client.post(f"{location}/actions", json={"type": "reject"})
            assert all(t["simulated"] for t in told)
            weighed = [t for t in told if t["state"] == "analysing"]
            assert len(weighed) >= 3
            if amplitude == "planned":  # the first of its cell: nobody knows before its analysis
                assert {t["eta_s"] for t in told if t["state"] == "running"} == {None}
                left = [t["motion_left_s"] for t in told if t["motion_left_s"]]
                assert left[0] <= plan["duration_s"]
                assert left[-1] < left[0]
            else:
                assert told[0]["eta_s"] > weighed[0]["eta_s"] > 0
            assert weighed[0]["progress"] < weighed[-1]["progress"] < 1.0
        # 0.5 % of rated torque is noise of the reading
        assert peaks["gentler"]["torque"] == pytest.approx(0.5 * peaks["planned"]["torque"], abs=1.0)
        assert peaks["gentler"]["travel"] < 0.7 * peaks["planned"]["travel"]


@pytest.mark.campaign
def test_a_run_that_a_dead_encoder_stops_shows_where_and_one_action(tmp_path: Path) -> None:
    with serving(tmp_path, cell=SMALL_CELL + STUCK) as service:
        location = service.start()
        body = service.wait(location, "stopped")
        found = body["stopped"]
        assert found["axis"] == "A1"
        assert found["phase"].startswith(("trying the amplitude", "experiment"))
        assert "encoder" in found["reason"]
        assert found["action"]["where"] == "machine"
        trace = found["trace"]
        assert trace["time_s"][-1] == 0.0
        assert -2.1 < trace["time_s"][0] < -1.0
        assert len(set(trace["position"]["A1"])) > 20
        assert trace["position"]["A1"][-1] == trace["position"]["A1"][-2]
        assert max(map(abs, trace["torque"]["A1"])) > 0.5
