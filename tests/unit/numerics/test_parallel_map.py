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


@pytest.mark.campaign
def test_a_diagnosis_is_the_same_on_one_core_and_on_two():
    """And every answer of a helper arrives: one that could not be packed would be found twice, unnoticed."""
    program = """
        import json, sys
        sys.path.insert(0, "tests")
        from hidden.generator import make
        from invid.model.diagnosis_document import diagnosis_to_json
        from invid.diagnosis.diagnose import diagnose

        calls, answered = [], []
        taken, received = processes._taken, processes._received
        def counted(run, items, numbers, caller=None):
            done = taken(run, items, numbers, caller)
            if caller is None:
                calls.append(len(items) - len(done))
            return done
        def read(answer, known):
            done = received(answer, known)
            answered.append(len(done))
            return done
        processes._taken, processes._received = counted, read
        recording, _ = make("coulomb_friction", seed=3, target_db=20.0, motors=2)
        diagnosis = diagnose(recording)
        assert answered == calls, (answered, calls)
        print(json.dumps(diagnosis_to_json(diagnosis), default=str, sort_keys=True))
    """
    alone = ran(program, cores=1)
    assert "coulomb_friction" in alone
    assert alone == ran(program)
