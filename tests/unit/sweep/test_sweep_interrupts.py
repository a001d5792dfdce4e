"""What a terminal, a system and a disk may do to a measurement: it stops in order."""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from test_sweep import RigidCell, config

from invid.errors import RecordingError
from invid.planning import make_plan
from invid.recording import Outcome, Recording, RecordingWriter, read_recording
from invid.sweep import Sweep
from invid.sweep.bounds import bounds_of
from invid.sweep.recorder import Recorder
from invid_drivers.cli.measure import stop_on_signals
from invid_drivers.realtime import leave_by

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP)


@pytest.fixture(autouse=True)
def _signals_as_before() -> Iterator[None]:
    before = {n: signal.getsignal(n) for n in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", SIGNALS)
def test_keys_and_a_closed_terminal_stop_the_cycle_process_in_order_whatever_its_parent_does(
    number: signal.Signals,
) -> None:
    stop = threading.Event()
    leave_by(stop)
    os.kill(os.getpid(), number)
    assert stop.wait(5.0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP])
def test_the_command_stops_in_order_on_whatever_a_terminal_sends(
    number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # this run itself may be under nohup
    monkeypatch.setattr(sys, "stderr", Gone())  # a terminal that was closed takes no message either
    with stop_on_signals() as stop:
        os.kill(os.getpid(), number)
        assert stop.wait(5.0)


def test_a_measurement_under_nohup_goes_on_when_the_terminal_is_closed() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with stop_on_signals() as stop:
        os.kill(os.getpid(), signal.SIGHUP)
        assert not stop.is_set()


class Gone:
    """A stream whose reader has gone."""

    def write(self, _text: str) -> int:
        raise BrokenPipeError(32, "Broken pipe")

    def flush(self) -> None:
        raise BrokenPipeError(32, "Broken pipe")


def test_a_disk_that_fills_up_stops_the_axes_and_keeps_what_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, cell, cfg = tmp_path / "run.h5", RigidCell(), config()
    cell.bounds = bounds_of(cfg, cell.resolution, cell.rated_torque)
    header = Recording("r", cell.axes, "rad", "N·m", "2026-01-01T00:00:00+00:00", ())
    plan = make_plan(cfg)
    recorder = Recorder(lambda: RecordingWriter(path, header), plan.cycle_s, 2)
    writes = 0

    def filling(_path: Any) -> SimpleNamespace:
        nonlocal writes
        writes += 1
        return SimpleNamespace(free=(100 if writes < 4 else 1) << 20)

    monkeypatch.setattr("invid.recording.writer.shutil.disk_usage", filling)
    with pytest.raises(RecordingError, match=r"nearly full.*kept"):
        Sweep(plan, cfg, cell, recorder).run()
    assert not cell.energised
    recorder.close(Outcome.FAILED)
    recording = read_recording(path)
    assert recording.outcome is Outcome.FAILED
    assert (
        0.8 < recording.experiments[0].samples * plan.cycle_s < 2.5
    )  # two bursts of a second, not the third
