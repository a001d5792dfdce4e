"""What now, on a real service with its real runner: half the torque, a stop, what separates two causes."""

from __future__ import annotations

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
FRICTION = "axes: {A1: {friction: {coulomb: 24.0, viscous: 0.1}}}\n"
LATE = """\
format: invid-config
format_version: 1
robot: one axis whose torque acts late
bus: {interface: invid-virtual, channel: late, cycle_s: 0.001}
axes:
  - name: A1
    node_id: 1
    rated_torque_Nm: 50
    masses: 2
    inertia_kgm2: 3
    gravity_loaded: false
    limits: {torque_Nm: 25, position_window_rad: 0.5, velocity_rad_per_s: 3, stopping_room_rad: 3}
safety: {heartbeat_s: 0.03}
simulation:
  seed: 1
  plant: {branches: [{axis: A1, masses: [1.0, 2.0], springs: [1500], dampers: [0.8]}]}
  defaults: {encoder_counts_per_rev: 524288, torque_noise_fraction_of_rated: 0.005}
  effects:
    - {cause: torque_delay, axis: A1, parameters: {delay: 0.004}}
experiments:
  - {kind: multisine, role: identify, band_Hz: [0.5, 6], period_s: 2, periods: 2, experiments: 1, seed: 1}
  - {kind: multisine, role: validate, band_Hz: [0.5, 6], period_s: 2, periods: 2, experiments: 1, seed: 2}
"""

TWO = """\
format: invid-config
format_version: 1
robot: two axes that shake each other
bus: {interface: invid-virtual, channel: two, cycle_s: 0.002}
axes:
  - name: A1
    node_id: 1
    rated_torque_Nm: 50
    masses: 2
    gravity_loaded: false
    limits: {torque_Nm: 25, position_window_rad: 0.5, velocity_rad_per_s: 3, stopping_room_rad: 3}
  - name: A2
    node_id: 2
    rated_torque_Nm: 30
    masses: 2
    gravity_loaded: false
    limits: {torque_Nm: 15, position_window_rad: 0.5, velocity_rad_per_s: 3, stopping_room_rad: 3}
safety: {heartbeat_s: 0.03}
simulation:
  seed: 3
  plant:
    branches:
      - {axis: A1, masses: [0.8, 1.5], springs: [900], dampers: [0.6]}
      - {axis: A2, masses: [0.5, 0.9], springs: [700], dampers: [0.4]}
    couplings: [{between: [A1, A2], value: 0.4}]
  defaults: {torque_noise_fraction_of_rated: 0.003}
experiments:
  - {kind: multisine, band_Hz: [0.5, 12], period_s: 4, periods: 2}
  - {kind: multisine, role: validate, band_Hz: [0.5, 12], period_s: 4, periods: 2, experiments: 1, seed: 2}
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
            assert any("half" in w for w in plan["warnings"]) == (amplitude == "gentler")
            service.client.post(f"{location}/actions", json={"type": "arm"})
            peaks[amplitude] = service.wait(location, "awaiting_accept")["measurement"]["peaks"]["A1"]
            told = progress_of(service, location)
            service.client.post(f"{location}/actions", json={"type": "reject"})
            assert all(t["simulated"] for t in told)
            weighed = [t for t in told if t["state"] == "analysing"]
            assert len(weighed) >= 3
            if amplitude == "planned":  # the first of its cell: nobody knows
                assert {t["eta_s"] for t in told} == {None}
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
def test_related_axes_do_no_more_than_was_announced_without_a_model_and_with_one(tmp_path: Path) -> None:
    with serving(tmp_path, cell=TWO) as service:
        for basis in ("trial", "model"):
            location = service.start(arm=False)
            plan = service.wait(location, "awaiting_arm")["plan"]
            service.client.post(f"{location}/actions", json={"type": "arm"})
            seen = service.wait(location, "analysing", "awaiting_accept")["measurement"]
            assert seen["outcome"] == "completed"
            assert seen["duration_s"] == pytest.approx(plan["duration_s"], rel=0.05)
            for told, before in zip(seen["forecast"], plan["forecast"], strict=True):
                assert told["basis"] == basis
                peak = seen["peaks"][told["axis"]]
                for what, limit in (
                    ("travel", "travel"),
                    ("velocity", "velocity"),
                    ("torque", "peak_torque"),
                ):
                    assert peak[what] <= told[limit] <= before[limit], (told["axis"], what)
            if basis == "trial":
                assert service.wait(location, "awaiting_accept")["summary"]["headline"]
                body = {"type": "accept", "override": "the first of this cell"}
                assert service.client.post(f"{location}/actions", json=body).status_code == 200
            else:
                service.client.post(f"{location}/actions", json={"type": "cancel"})


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


@pytest.mark.campaign
def test_friction_above_the_planned_torque_ends_with_one_action_that_asks_for_no_less(tmp_path: Path) -> None:
    with serving(tmp_path, cell=SMALL_CELL.replace("  defaults:", f"  {FRICTION}  defaults:")) as service:
        found = service.wait(service.start(), "stopped")["stopped"]
        assert found["phase"] == "trying the signs of A1"
        assert found["action"]["code"] == "free_axis"
        assert "axes[A1].limits.torque_Nm" in found["action"]["text"]
        assert "lower" not in found["action"]["text"] + found["reason"]
        # with the small torques of a test the first thing is to use the planned ones
        found = service.wait(service.start(mode="test"), "stopped")["stopped"]
        assert found["action"]["code"] == "as_planned"


@pytest.mark.campaign
def test_a_delay_not_told_from_a_lag_is_told_by_the_run_that_the_result_offers(tmp_path: Path) -> None:
    with serving(tmp_path, cell=LATE) as service:
        first = service.run_to_result()
        offered = service.client.get(first).json()["separating"]
        assert offered["finding"] == 0
        assert "a lag loses amplitude and a delay does not" in offered["text"]
        identity = first.rsplit("/", 1)[-1]
        second = service.start(arm=False, separate=identity)
        waiting = service.wait(second, "awaiting_arm")
        assert waiting["separates"] == identity
        assert waiting["plan"]["purpose"] == offered["text"]
        assert waiting["plan"]["warnings"][0] == offered["text"]
        assert max(e["highest_Hz"] for e in waiting["plan"]["experiments"]) > 10
        service.client.post(f"{second}/actions", json={"type": "arm"})
        body = service.wait(second, "awaiting_accept")
        (finding,) = [f for f in body["summary"]["findings"] if f["axis"] == "A1"]
        assert finding["cause"] == "torque_delay"
        assert finding["consequence"]["grade"] in ("as_expected", "watch", "act")
        assert finding["consequence"]["reason"]
        assert body["separating"] is None


@pytest.mark.campaign
def test_an_upload_of_a_cell_is_compared_and_one_of_another_robot_fails(tmp_path: Path) -> None:
    other = LATE.replace("name: A1", "name: B1").replace("axis: A1", "axis: B1")
    with serving(tmp_path) as service:
        run = service.run_to_result()
        file = service.client.get(f"{run}/recording").content
        headers = {"Content-Type": "application/x-hdf5"}
        answer = service.client.post("/api/v1/recordings?cell=small", content=file, headers=headers)
        location = answer.headers["Location"]
        body = service.wait(location, "succeeded")
        assert (body["cell"], body["mode"]) == ("small", "upload")
        assert body["decision"] is None
        identity = location.rsplit("/", 1)[-1]
        changes = service.client.get(
            "/api/v1/cells/small/changes", params={"from": run.rsplit("/", 1)[-1], "to": identity}
        ).json()
        assert {p["status"] for p in changes["parameters"]} <= {"unchanged", "cannot_tell"}
    (tmp_path / "other").mkdir()
    with serving(tmp_path / "other", cell=other) as service:
        answer = service.client.post("/api/v1/recordings?cell=small", content=file, headers=headers)
        body = service.wait(answer.headers["Location"], "failed")
        assert "it has the axes A1, the cell has B1" in body["error"]["text"]
