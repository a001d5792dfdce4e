"""A runner that is a script of messages, and an application around it. A double for tests only: the
product starts ``invid_service.jobs.worker``."""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import h5py
import numpy as np
from fastapi.testclient import TestClient

from invid.model.chains import case_study
from invid.model.document import ChainStd, Model, model_to_json, parameter_vector
from invid_drivers.protocol import AxisStates, Done, LastSeen, Stop
from invid_service import service
from invid_service.app import create_app
from invid_service.jobs.protocol import (
    Arm,
    EndedEarly,
    ErrorInfo,
    Job,
    Measured,
    Planned,
    Running,
    RunProgress,
    Told,
)
from invid_service.settings import Settings

CELL = """\
format: invid-config
format_version: 1
robot: test robot
bus: {interface: invid-virtual, channel: test, cycle_s: 0.001}
axes:
  - name: A1
    node_id: 1
    rated_torque_Nm: 50
    limits: {torque_Nm: 25, position_window_rad: 0.5, velocity_rad_per_s: 3}
  - name: A2
    node_id: 2
    rated_torque_Nm: 100
    limits: {torque_Nm: 50, position_window_rad: 0.5, velocity_rad_per_s: 3}
  - name: A3
    node_id: 3
    rated_torque_Nm: 200
    limits: {torque_Nm: 100, position_window_rad: 0.5, velocity_rad_per_s: 3}
simulation:
  plant: {case_study: true, damping_ratio: 0.01}
"""


def model_document(*, scale_mass: float = 1.0, std: float = 1e-3) -> dict[str, Any]:
    """A model of the case study; ``scale_mass`` multiplies the final mass of A2."""
    chains = case_study(damping_ratio=0.01)
    names, values = parameter_vector(chains)
    covariance = np.diag((std * np.abs(values)) ** 2)
    model = Model(
        robot="test robot",
        method="refined",
        chains=chains,
        std=ChainStd.unknown(chains),
        covariance=covariance,
        parameter_names=names,
    )
    document = model_to_json(model)
    for branch in document["branches"]:
        for kind in ("masses", "springs", "dampers"):
            for e in branch[kind]:
                e["std"] = std * e["value"]
    for c in document["couplings"]:
        c["std"] = std * c["value"]
    document["branches"][1]["masses"][-1]["value"] *= scale_mass
    return document


class ScriptedWorker:
    """Plays a run: plans, waits for arm, moves until told to go on, writes results."""

    def __init__(self, job: Job, director: Director) -> None:
        self.job, self.director = job, director
        self.said: list[Arm | Stop] = []
        self.stopped = asyncio.Event()
        self.armed = asyncio.Event()
        self.killed = asyncio.Event()
        if job.arm:
            self.armed.set()

    def send(self, wish: Arm | Stop) -> None:
        self.said.append(wish)
        if wish == Arm():
            self.armed.set()
        elif not self.director.deaf:
            self.stopped.set()

    def kill(self) -> None:
        self.killed.set()

    async def wait(self) -> int:
        return -9 if self.killed.is_set() else 0

    async def _until(self, event: asyncio.Event) -> str:
        waits = {
            name: asyncio.ensure_future(e.wait())
            for name, e in (("event", event), ("stop", self.stopped), ("kill", self.killed))
        }
        await asyncio.wait(waits.values(), return_when=asyncio.FIRST_COMPLETED)
        seen = [name for name in ("kill", "stop", "event") if waits[name].done()]
        for task in waits.values():
            task.cancel()
        return seen[0]

    async def messages(self) -> AsyncIterator[Told]:
        stopped = EndedEarly("stopped", ErrorInfo(code="stopped", text="stopped", fix="start again"))
        if self.job.kind == "measure":
            plan = {"duration_s": 10.0, "forecast": [{"axis": "A1", "peak_torque": 5.0, "travel": 0.1}]}
            yield Planned(plan, self.job.arm)
            if (seen := await self._until(self.armed)) != "event":
                if seen == "stop":
                    yield stopped
                return
            yield Running()
            yield AxisStates(self.director.axes)
            for k in range(3):
                yield RunProgress(progress=0.1 * k, phase="A1", axis="A1", eta_s=5.0)
            if (seen := await self._until(self.director.go)) != "event":
                if seen == "stop" and not self.director.die:
                    self._recording()
                    yield stopped
                return
            self._recording()
            yield Measured()
        if self.director.failure is not None:
            failure = ErrorInfo(**self.director.failure)
            yield EndedEarly("failed", failure, self.director.stopped)
            return
        if self.director.die:
            return
        if (seen := await self._until(self.director.analyse)) != "event":
            return
        self._results()
        summary = {"verdict": self.director.verdict, "sentences": ["All is well."], **self.director.summary}
        yield Done(summary)

    def _recording(self) -> None:
        with h5py.File(self.job.folder / "recording.h5", "w") as file:
            file.attrs["format"] = "invid-recording"

    def _results(self) -> None:
        folder, director = self.job.folder, self.director
        document = {**director.model(), "simulated": self.job.simulated}
        (folder / "model.json").write_text(json.dumps(document))
        diagnosis = {
            "format": "invid-diagnosis",
            "verdict": director.verdict,
            "simulated": self.job.simulated,
            "findings": director.findings,
            **director.diagnosis(),
        }
        (folder / "diagnosis.json").write_text(json.dumps(diagnosis))
        (folder / "report.html").write_text("<html><body>report</body></html>")


class Director:
    """What scripted runs do."""

    def __init__(self, *, held_in: str = "", deaf: bool = False, die: bool = False) -> None:
        """``held_in`` "running" or "analysing": it stays there until the event of that name is set."""
        self.go = asyncio.Event()
        self.analyse = asyncio.Event()
        for state, event in (("running", self.go), ("analysing", self.analyse)):
            if state != held_in:
                event.set()
        self.deaf, self.die = deaf, die
        """The runner ends without a word: at once, or, where it is held up by ``go``, when it is stopped."""
        self.axes: tuple[LastSeen, ...] = ()
        self.failure: dict[str, Any] | None = None
        self.stopped: dict[str, Any] | None = None
        self.findings: list[dict[str, Any]] = []
        self.summary: dict[str, Any] = {}
        self.verdict = "consistent"
        self.model: Callable[[], dict[str, Any]] = model_document
        self.diagnosis: Callable[[], dict[str, Any]] = dict
        """What more stands in it: without, it is one that cannot be read."""
        self.workers: list[ScriptedWorker] = []

    async def launch(self, job: Job) -> ScriptedWorker:
        job.folder.mkdir(parents=True, exist_ok=True)
        worker = ScriptedWorker(job, self)
        self.workers.append(worker)
        return worker


def settings_in(folder: Path, **given: Any) -> Settings:
    """Settings of a service with the test cell."""
    config = folder / "cell.yaml"
    if not config.exists():
        config.write_text(CELL)
    base = {"cells": [config], "data_dir": folder / "data", "min_free_bytes": 0}
    if "invid-virtual" in config.read_text():  # hardware gets no less than the way out needs
        base["stop_grace_s"] = 0.5
    return Settings(**{**base, **given})


_refusal_of, _refusals = service._refusal_of, dict[Any, Any]()


def _refused_once(config: Any, amplitude: float, axes: Any, in_force: Any) -> Any:
    """What a plan of this config is refused for, worked out once a process: seconds of planning."""
    # Where the drives' memory lies is another folder in each test, and no part of the plan.
    text = re.sub(r'"memory":"[^"]*"', "", config.model_dump_json())
    key = (text, amplitude, axes, in_force and in_force.document)
    if key not in _refusals:
        _refusals[key] = _refusal_of(config, amplitude, axes, in_force)
    return _refusals[key]


@contextmanager
def running(
    folder: Path, director: Director | None = None, **given: Any
) -> Iterator[tuple[TestClient, Director]]:
    """A client of a running application."""
    director = director or Director()
    app = create_app(settings_in(folder, **given), launcher=director.launch)
    with (
        patch.object(service, "_refusal_of", _refused_once),
        TestClient(app, raise_server_exceptions=False, base_url="http://127.0.0.1") as client,
    ):
        yield client, director


START = "/api/v1/cells/cell/identifications"


def start(client: TestClient, cell: str = "cell", **body: Any) -> str:
    """Start a run that waits for nobody; its address."""
    answer = client.post(f"/api/v1/cells/{cell}/identifications", json={"mode": "full", "arm": True, **body})
    assert answer.status_code == 202, answer.text
    assert int(answer.headers["Retry-After"]) >= 1
    location: str = answer.headers["Location"]
    return location


def until(holds: Callable[[], Any], seconds: float = 10.0) -> Any:
    """Wait until something holds; what it is then."""
    deadline = time.monotonic() + seconds
    while not (found := holds()):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return found


def wait_for(client: TestClient, location: str, *states: str, timeout: float = 30.0) -> dict[str, Any]:
    """Poll until the run is in one of ``states``; fails with what it saw."""
    deadline = time.monotonic() + timeout
    while time.monotonic() < deadline:
        body: dict[str, Any] = client.get(location).json()
        if body.get("state") in states:
            return body
        time.sleep(0.01)
    raise AssertionError(f"{location} did not reach {states}: {body}")


def started(client: TestClient, state: str = "awaiting_accept", **body: Any) -> str:
    """Start a run and wait until it is in that state; its address."""
    location = start(client, **body)
    wait_for(client, location, state)
    return location


def act(client: TestClient, location: str, kind: str, **more: Any) -> Any:
    """The answer to an action."""
    return client.post(f"{location}/actions", json={"type": kind, **more})


def accepted(client: TestClient, **body: Any) -> str:
    """The address of a run whose result was accepted."""
    location = started(client, **body)
    assert act(client, location, "accept").status_code == 200
    return location


def kind(answer: Any) -> str:
    """The problem that an answer is."""
    assert answer.headers["content-type"] == "application/problem+json", answer.text
    return str(answer.json()["type"]).removeprefix("urn:invid:problem:")


def bearer(key: str) -> dict[str, str]:
    """Headers of whoever has the key."""
    return {"Authorization": f"Bearer {key}"}
