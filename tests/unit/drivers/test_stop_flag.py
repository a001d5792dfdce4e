"""A stop that signal handlers set, one inside the other."""

import subprocess
import sys
import threading
import time

from invid_drivers.stop_flag import StopFlag

INTERRUPTED = """
import os, signal, sys, threading
from invid_drivers.stop_flag import StopFlag

stop = {made}
sent = []

def trace(frame, event, argument):
    # at every line of ``set`` the next signal comes
    if frame.f_code.co_name == "set" and event == "line" and len(sent) < 20:
        sent.append(event)
        os.kill(os.getpid(), signal.SIGTERM)
    return trace

def handler(number, frame):
    sys.settrace(trace)
    stop.set()

signal.signal(signal.SIGTERM, handler)
os.kill(os.getpid(), signal.SIGTERM)
sys.settrace(None)
print(len(sent), stop.is_set())
"""


def interrupted(made: str, seconds: float) -> str:
    """What a process says whose stop is set by handlers that interrupt each other within ``set``."""
    code = INTERRUPTED.format(made=made)
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=seconds
    ).stdout.strip()


def test_a_handler_within_a_handler_never_waits_for_it() -> None:
    sent, set_ = interrupted("StopFlag()", 120).split()
    assert int(sent) > 2
    assert set_ == "True"


def test_whoever_waits_is_woken_at_once_and_a_timeout_ends_the_waiting() -> None:
    stop = StopFlag()
    began = time.monotonic()
    assert not stop.wait(0.05)
    assert time.monotonic() - began >= 0.05
    threading.Timer(0.05, stop.set).start()
    assert stop.wait(60.0)
    assert time.monotonic() - began < 30.0
    assert stop.wait()
    for _ in range(100_000):  # however often it is set
        stop.set()
    assert stop.is_set()
