"""Independent calls on several cores: the answers of one process, whatever becomes of a helper.

Forking needs a process without threads, which a test runner's worker is not: each test has one of its own.
"""

from __future__ import annotations

import subprocess
import sys
import textwrap

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="helpers are forked on Linux alone")

BEGIN = """
import multiprocessing, os, threading, time
from invid.numerics import parallel as processes
from invid.numerics.parallel import parallel_map
me = os.getpid()
"""


def ran(text: str, *, cores: int | None = 2) -> str:
    """What a program printed; ``cores``: those it takes itself to have, the machine's where none."""
    given = "" if cores is None else f"os.sched_getaffinity = lambda _: set(range({cores}))\n"
    done = subprocess.run(
        [sys.executable, "-c", BEGIN + given + textwrap.dedent(text)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    "end", ["os._exit(3)", "os.kill(os.getpid(), 9)", "raise ValueError", "return lambda: 0"]
)
def test_a_helper_that_dies_or_cannot_answer_loses_nothing(end: str):
    assert "all" in ran(f"""
        def run(k):
            time.sleep(0.02)
            if os.getpid() != me:
                {end}
            return k
        assert parallel_map(run, range(6)) == list(range(6))
        assert not multiprocessing.active_children()
        print("all")
    """)


def test_what_raises_is_raised_here_and_no_helper_outlives_it():
    assert "raised" in ran("""
        def run(k):
            if k == 3:
                raise ValueError(f"call {k}")
            time.sleep(30 if os.getpid() != me else 0)
            return k
        began = time.monotonic()
        try:
            parallel_map(run, [0, 3, 3, 3])
        except ValueError as error:
            assert str(error) == "call 3"
            print("raised")
        assert not multiprocessing.active_children() and time.monotonic() - began < 10
    """)


def test_helpers_end_with_a_caller_that_was_killed():
    """One with a long answer would wait for ever for somebody to read it."""
    assert "gone" in ran("""
        import signal, subprocess, sys
        text = '''
        import os, time
        os.sched_getaffinity = lambda _: set(range(3))
        from invid.numerics.parallel import parallel_map
        me = os.getpid()
        def run(k):
            if os.getpid() == me:
                time.sleep(60)
            os.write(1, b"%d%c" % (os.getpid(), 10))  # a line at once, whoever else writes
            return bytes(1_000_000)
        parallel_map(run, range(6))
        '''
        import textwrap
        caller = subprocess.Popen([sys.executable, "-c", textwrap.dedent(text)], stdout=subprocess.PIPE)
        helpers = {int(caller.stdout.readline()) for _ in range(5)}
        caller.kill()
        caller.wait()
        deadline = time.monotonic() + 20
        while any(os.path.exists(f"/proc/{pid}") for pid in helpers) and time.monotonic() < deadline:
            time.sleep(0.05)
        left = [pid for pid in helpers if os.path.exists(f"/proc/{pid}")]
        assert not left, left
        print("gone")
    """)
