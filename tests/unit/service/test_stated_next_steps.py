"""What now: amplitude, the separating experiment, the action after a stop, the plant's overview, uploads."""

import io
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from service_doubles import START, Director, running, start, wait_for

from invid.errors import SafetyStop
from invid.sweep.moment import Moment
from invid_service.jobs.stops import Run, action_for, stopped_by

HDF5 = {"Content-Type": "application/x-hdf5"}
OPEN = {
    "cause": "torque_delay",
    "axis": "A2",
    "alternatives": [{"cause": "torque_lag", "axis": "A2", "element": "mass 1", "after": 0.1}],
}


def moment(rows: int = 3) -> Moment:
    time = np.linspace(-1.0, 0.0, rows)
    position = np.outer(np.linspace(0, 0.6, rows), [1.0, 0.0])
    return Moment(("A1", "A2"), "experiment 2 of 4", None, time, position, 10.0 * position)


def stop(error: Any, rows: int = 3) -> Any:
    error.moment = moment(rows)
    return error


def test_the_separating_experiment_runs_instead_of_the_cells_own(tmp_path: Path) -> None:
    director = Director()
    director.findings = [{"cause": "backlash", "axis": "A1", "alternatives": []}, OPEN]
    director.summary = {"separating": {"finding": 1, "text": "a band up to 100 Hz"}}
    with running(tmp_path, director) as (client, _):
        first = start(client)
        assert wait_for(client, first, "awaiting_accept")["separating"]["finding"] == 1
        identity = first.rsplit("/", 1)[-1]
        second = client.post(START, json={"mode": "full", "separate": identity}).headers["Location"]
        body = wait_for(client, second, "awaiting_arm")
        assert body["separates"] == identity
        job = director.workers[-1].job
        assert "a lag loses amplitude and a delay does not" in str(job.purpose)
        assert job.config is not None
        assert max(e["band_Hz"][1] for e in job.config["experiments"]) == 30.0  # of 12


def test_a_stopped_run_shows_phase_trace_and_one_action(tmp_path: Path) -> None:
    error = stop(SafetyStop("axis A1: position left its window", code="position_window", axis="A1"))
    director = Director()
    director.failure = {"code": "safety-stop", "text": "left its window", "fix": "look"}
    director.stopped = stopped_by(error, Run("full", "planned", False, None))
    with running(tmp_path, director) as (client, _):
        location = start(client)
        found = wait_for(client, location, "failed")["stopped"]
        assert (found["phase"], found["axis"]) == ("experiment 2 of 4", "A1")
        assert found["action"] == {
            "code": "gentler",
            "text": "Start again with half of the torque and half of the motion.",
            "where": "page",
        }
        assert found["trace"]["time_s"] == [-1.0, -0.5, 0.0]
        assert found["trace"]["position"]["A1"] == [0.0, 0.3, 0.6]
        (listed,) = client.get("/api/v1/identifications").json()["identifications"]
        assert listed["stopped"]["trace"]["time_s"] == []


@pytest.mark.parametrize("mode", ["full", "test"])
@pytest.mark.parametrize("amplitude", ["planned", "gentler"])
def test_no_action_asks_for_less_torque_where_friction_holds_the_axis(mode: str, amplitude: str) -> None:
    # 3 N·m of friction against a small torque: "raise limits.torque … start again with a lower amplitude"
    action = action_for("stands", Run(mode, amplitude, False, "A1"))
    assert action["code"] in ("free_axis", "as_planned")
    assert (action["code"] == "free_axis") == (mode == "full" and amplitude == "planned")
    assert "gentler" not in action["text"]
    assert "lower" not in action["text"]


def recording() -> bytes:
    file = io.BytesIO()
    with h5py.File(file, "w") as out:
        out.attrs["format"] = "invid-recording"
        out.create_dataset("x", data=np.arange(10.0))
    return file.getvalue()


@pytest.mark.parametrize("how", ["query", "form"])
def test_an_upload_joins_the_history_of_a_cell_and_measures_nothing(tmp_path: Path, how: str) -> None:
    with running(tmp_path) as (client, director):
        if how == "query":
            answer = client.post("/api/v1/recordings?cell=cell", content=recording(), headers=HDF5)
        else:
            answer = client.post(
                "/api/v1/recordings", data={"cell": "cell"}, files={"file": ("r.h5", recording())}
            )
        assert answer.status_code == 202, answer.text
        location = answer.headers["Location"]
        body = wait_for(client, location, "succeeded")
        assert (body["cell"], body["mode"]) == ("cell", "upload")
        assert director.workers[0].job.config is not None
        (listed,) = client.get("/api/v1/identifications?cell=cell").json()["identifications"]
        assert listed["id"] == body["id"]
        models = client.get("/api/v1/cells/cell/models").json()["models"]
        assert [(m["id"], m["mode"], m["in_force"]) for m in models] == [(body["id"], "upload", False)]
        points = client.get("/api/v1/cells/cell/series?parameter=A1.mass.1").json()["points"]
        assert [p["mode"] for p in points] == ["upload"]
        # no measurement of the cell: not its last run, and nothing to accept
        cell = client.get("/api/v1/cells/cell").json()
        assert cell["last_identification"] is None
        assert cell["overview"]["last_run"] is None
        assert client.post(f"{location}/actions", json={"type": "accept"}).status_code == 409
