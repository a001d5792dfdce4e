"""What a poll carries: the large parts of a run stand at addresses of their own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from service_doubles import CELL, Director, running, start, wait_for

from invid_drivers.protocol import RunProgress
from invid_service.jobs.live import LiveRun
from invid_service.jobs.states import State

BUFFER = 1024
"""Bytes that the contract promises to a PLC."""


def state_of(client: Any, cell: str = "cell") -> dict[str, Any]:
    answer = client.get(f"/api/v1/cells/{cell}/state")
    assert answer.status_code == 200, answer.text
    assert len(answer.content) < BUFFER
    return dict(answer.json())


def test_the_state_fits_a_small_buffer_with_the_longest_names_that_there_are(tmp_path: Path) -> None:
    config = tmp_path / f"{'a cell with a very long name ' * 5}.yaml"
    config.write_text(CELL)
    director = Director()
    director.failure = {"code": "a-code-that-is-as-long-as-the-longest", "text": "x" * 4000, "fix": "y"}
    with running(tmp_path, director, cells=[config]) as (client, _):
        (cell,) = client.get("/api/v1/cells").json()["cells"]
        assert len(cell["id"]) == 64
        location = start(client, cell["id"])
        wait_for(client, location, "failed")
        assert state_of(client, cell["id"])["error"] == director.failure["code"]
        service = client.app.state.service
        record = service.store.run(location.rsplit("/", 1)[1])
        longest = LiveRun(replace(record, state=State.RUNNING, ended=None, id="9" * 40))
        for character in ("\U0001f916", "\x01"):  # four bytes; six where JSON escapes it
            longest.progress = RunProgress(
                progress=1 / 3,
                phase=character * 1000,
                axis="A" * 64,
                frequency=1 / 3,
                eta_s=1e9 / 3,
                motion_left_s=1e9 / 3,
            )
            service.jobs._latest[cell["id"]] = longest
            assert state_of(client, cell["id"])["phase"] == character * 60
