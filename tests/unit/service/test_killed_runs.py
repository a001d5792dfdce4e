"""What is left of a run whose process, or whose service, was killed: rows become its recording."""

import sqlite3
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from service_doubles import Director, running, settings_in, until, wait_for
from sqlalchemy.exc import OperationalError

from invid.recording import Kind, Outcome, Recording, RecordingWriter, read_recording
from invid_drivers.protocol import AxisStates, LastSeen
from invid_service.app import create_app
from invid_service.jobs.folder import LastWords
from invid_service.jobs.states import State
from invid_service.store.blobs import Blobs
from invid_service.store.store import RunRecord

RUN = "20261125T142221-0a1b2c3d"
PATH = f"/api/v1/identifications/{RUN}"
AXES = ("A1", "A2", "A3")


def written(path: Path, rows: int) -> RecordingWriter:
    """A recording in the making, as a killed process leaves it: its rows flushed, nobody to close it."""
    head = Recording(
        robot="test robot", axes=AXES, position_unit="rad", torque_unit="N·m",
        created="2026-01-01T00:00:00Z", experiments=(), attributes={"simulated": True},
    )  # fmt: skip
    writer = RecordingWriter(path, head)
    writer.begin(kind=Kind.OTHER, excited_axis=0, sample_rate_hz=1000.0, demand=False, status=False)
    values = np.arange(3.0 * rows).reshape(rows, 3)
    writer.append(np.arange(rows) / 1000, values, values)
    writer.flush()
    return writer


def cut_off(folder: Path, state: State, name: str = RUN, *, simulated: bool = True) -> Blobs:
    """A store in which a run is going on, and nobody who works for it."""
    app = create_app(settings_in(folder), launcher=Director().launch)
    service = app.state.service
    now = datetime.now(UTC)
    record = RunRecord(
        id=name, cell="cell", robot="test robot", mode="full", axes=AXES, simulated=simulated, state=state,
        created=now, started=now, requested_by="local",
    )  # fmt: skip
    service.store.add_run(record)
    service.store.close()
    service.lock.release()
    blobs: Blobs = service.blobs
    return blobs


def fetched(client: TestClient, folder: Path) -> Recording:
    answer = client.get(f"{PATH}/recording")
    assert answer.status_code == 200, answer.text
    file = folder / "fetched.h5"
    file.write_bytes(answer.content)
    return read_recording(file)


def test_rows_of_a_run_that_was_cut_off_are_its_recording_marked_failed(tmp_path: Path) -> None:
    scratch = cut_off(tmp_path, State.RUNNING).scratch(RUN)
    written(scratch / "recording.h5", 2500)
    with running(tmp_path) as (client, _):
        body = client.get(PATH).json()
        assert body["state"] == "interrupted"
        assert "kept as this run's recording" in body["error"]["fix"]
        recording = fetched(client, tmp_path)
    assert recording.outcome is Outcome.FAILED
    assert recording.experiments[0].samples == 2500
    assert recording.experiments[0].position[-1].tolist() == [7497.0, 7498.0, 7499.0]
    assert not scratch.exists()


def test_a_run_that_moved_when_its_service_died_is_unknown_axis_by_axis_or_ended_as_its_runner_said(
    tmp_path: Path,
) -> None:
    seen = AxisStates((LastSeen("A1", "quick stop active", 0.0),))
    for words in (LastWords(seen), LastWords(end="stopped on request"), LastWords()):
        folder = tmp_path / (words.end or str(len(words.axes.axes)))
        folder.mkdir()
        words.write(cut_off(folder, State.RUNNING, simulated=False).scratch(RUN))
        with running(folder) as (client, _):
            body = client.get(PATH).json()
            is_unknown = client.post("/api/v1/cells/cell/stop").json()["unknown"]
        assert body["state"] == "interrupted"
        assert ("unknown, look" in body["error"]["text"]) is is_unknown is not bool(words.end)
        assert ("ended: stopped on request" in body["error"]["text"]) is bool(words.end)
        assert ("axis A1 was last seen quick stop active" in body["error"]["text"]) is bool(words.axes.axes)


def test_a_cut_between_file_and_store_loses_nothing(tmp_path: Path) -> None:
    """The file has been moved to its place, its row was not written yet."""
    blobs = cut_off(tmp_path, State.RUNNING)
    scratch = blobs.scratch(RUN)
    written(scratch / "recording.h5", 1000).close(Outcome.ABORTED)
    assert blobs.put(RUN, "recording", scratch / "recording.h5") is not None
    with running(tmp_path) as (client, _):
        assert fetched(client, tmp_path).outcome is Outcome.ABORTED


def test_the_recording_of_a_cut_off_run_is_analysed_as_a_run_of_its_own(tmp_path: Path) -> None:
    written(cut_off(tmp_path, State.RUNNING).scratch(RUN) / "recording.h5", 2500)
    with running(tmp_path) as (client, director):
        answer = client.post(f"{PATH}/analysis")
        assert answer.status_code == 202, answer.text
        assert answer.json()["analyses"] == RUN
        done = wait_for(client, answer.headers["Location"], "succeeded")
        assert done["mode"] == "upload"
        assert (done["cell"], done["simulated"]) == ("cell", True)
        (worker,) = director.workers
        assert worker.job.kind == "analyse"
        assert client.get(PATH).json()["state"] == "interrupted"
        assert fetched(client, tmp_path).experiments[0].samples == 2500  # it has its recording still


def test_a_run_whose_end_a_full_disk_does_not_take_is_told_and_stored_when_there_is_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("invid_service.jobs.manager._KEEP_RETRY_S", 0.2)

    def full(*_: Any) -> None:
        raise OperationalError("INSERT", None, sqlite3.OperationalError("database or disk is full"))

    with running(tmp_path, Director(held_in="running")) as (client, director):
        body = {"mode": "full", "arm": True}
        location = client.post("/api/v1/cells/cell/identifications", json=body).headers["Location"]
        wait_for(client, location, "running")
        store = client.app.state.service.store  # type: ignore[attr-defined]
        with monkeypatch.context() as patched:
            patched.setattr(store, "save_state", full)
            patched.setattr(store, "add_artefacts", full)
            director.failure = {
                "code": "disk-full",
                "text": "model.json: cannot be written",
                "fix": "make room",
            }
            client.portal.call(director.go.set)
            assert wait_for(client, location, "failed")["error"]["code"] == "disk-full"
            time.sleep(1.5)  # the store still says "running"
            assert client.get(location).json()["state"] == "failed"
            assert client.get("/api/v1/cells/cell/state").json()["state"] == "failed"
        jobs = client.app.state.service.jobs  # type: ignore[attr-defined]
        until(lambda: client.get(f"{location}/recording").status_code == 200)
        until(lambda: jobs.live(location.rsplit("/", 1)[1]) is None)
        assert client.get(location).json()["state"] == "failed"


def test_what_the_store_does_not_take_waits_for_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    with running(tmp_path) as (client, _), monkeypatch.context() as patched:
        patched.setattr(Blobs, "put", full)
        body = {"mode": "full", "arm": True}
        location = client.post("/api/v1/cells/cell/identifications", json=body).headers["Location"]
        error = wait_for(client, location, "failed")["error"]
        assert error["code"] == "disk-full"
        assert "MiB are free" in error["text"]
        assert str(tmp_path) not in error["text"]
        assert "make room on it: what was measured is kept" in error["fix"]
        assert client.get(f"{location}/recording").status_code == 404
    with running(tmp_path) as (client, _):
        assert client.get(location).json()["state"] == "failed"
        assert client.get(f"{location}/recording").status_code == 200
