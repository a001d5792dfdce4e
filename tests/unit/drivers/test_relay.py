"""The parent of the cycle process waits for it no longer than stated, and hears what it says at its end."""

import threading
import time
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from invid.errors import BusError, SafetyStop, note_left
from invid_drivers import relay
from invid_drivers.filing import Filing
from invid_drivers.protocol import AxisStates, Failed, LastSeen, Stop
from invid_drivers.relay import Listeners, Relay


@pytest.fixture
def ends(tmp_path: Path) -> tuple[Relay, threading.Event, Connection, Connection]:
    ours, theirs = Pipe()
    stop = threading.Event()
    return Relay(Filing(tmp_path / "rec.h5", None), Listeners(stop=stop)), stop, ours, theirs


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
    assert Stop() in said
    parent.end()


def test_what_the_cycle_process_knows_of_its_axes_is_heard_after_a_second_ctrl_c(
    ends: tuple[Relay, threading.Event, Connection, Connection],
) -> None:
    parent, _, ours, theirs = ends

    def answer() -> None:
        while theirs.recv() != Stop():
            pass
        error = SafetyStop("stopped on request", code="asked")
        note_left(error, ["axis A1 is energised: it is held by its drive"])
        theirs.send(Failed(error))

    threading.Thread(target=answer, daemon=True).start()
    parent.speak_to(ours)
    assert parent.last_words(ours) == ("axis A1 is energised: it is held by its drive",)
    parent.end()


def test_of_a_cycle_process_that_is_lost_every_axis_is_named_with_its_last_state(
    ends: tuple[Relay, threading.Event, Connection, Connection],
) -> None:
    parent, _, ours, theirs = ends
    for state in ("led by this master", "held by its drive"):
        theirs.send(AxisStates((LastSeen("A1", state, 0.0),)))
    theirs.close()
    with pytest.raises(EOFError):
        parent.run(ours)
    parent.end()
    first, second = parent.states.of(["A1", "A2"])
    assert first.sentence.startswith("axis A1 was last seen held by its drive, at ")
    assert second.sentence == "axis A2 was not seen under power"
