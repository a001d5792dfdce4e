"""The parent of the cycle process waits for it no longer than stated, and hears what it says at its end."""

from __future__ import annotations

import threading
import time
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from invid.errors import BusError, SafetyStop, note_left
from invid_drivers import relay
from invid_drivers.filing import Filing
from invid_drivers.relay import Relay


@pytest.fixture
def ends(tmp_path: Path) -> tuple[Relay, threading.Event, Connection, Connection]:
    ours, theirs = Pipe()
    stop = threading.Event()
    return Relay(Filing(tmp_path / "rec.h5", None), stop, None), stop, ours, theirs


def test_a_cycle_process_that_does_not_stop_is_given_up_after_the_stated_time(
    ends: tuple[Relay, threading.Event, Connection, Connection], monkeypatch: pytest.MonkeyPatch
) -> None:
    parent, stop, ours, theirs = ends
    monkeypatch.setattr(relay, "STOP_S", 0.3)
    stop.set()
    began = time.monotonic()
    with pytest.raises(BusError, match="did not stop within"):
        parent.run(ours)
    assert time.monotonic() - began < 2.0
    said = {theirs.recv() for _ in range(2)}
    assert "stop" in said
    parent.end()


def test_what_the_cycle_process_knows_of_its_axes_is_heard_after_a_second_ctrl_c(
    ends: tuple[Relay, threading.Event, Connection, Connection],
) -> None:
    parent, _, ours, theirs = ends

    def answer() -> None:
        while theirs.recv() != "stop":
            pass
        error = SafetyStop("stopped on request", code="asked")
        note_left(error, ["axis A1 is energised: it is held by its drive"])
        theirs.send(("error", error))

    threading.Thread(target=answer, daemon=True).start()
    parent.speak_to(ours)
    assert parent.last_words(ours) == ("axis A1 is energised: it is held by its drive",)
    parent.end()
