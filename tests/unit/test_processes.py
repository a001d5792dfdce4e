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
from invid import processes
from invid.processes import at_once
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


def test_two_processes_share_the_calls_and_the_answers_stand_in_order():
    assert "shared" in ran("""
        def run(k):
            time.sleep(0.02)
            return k * k, os.getpid()
        answers = at_once(run, range(20))
        assert [a for a, _ in answers] == [k * k for k in range(20)]
        assert len({pid for _, pid in answers}) == 2 and me in {pid for _, pid in answers}
        assert not multiprocessing.active_children()
        print("shared")
    """)


def test_answers_refer_to_the_callers_own_objects():
    assert "same" in ran("""
        large = object()
        class Answer:
            def __init__(self): self.of, self.pid = large, os.getpid()
        def run(_):
            time.sleep(0.02)
            return Answer()
        answers = at_once(run, range(8), known=[large])
        assert any(a.pid != me for a in answers)
        assert all(a.of is large for a in answers)
        print("same")
    """)


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
        assert at_once(run, range(6)) == list(range(6))
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
            at_once(run, [0, 3, 3, 3])
        except ValueError as error:
            assert str(error) == "call 3"
            print("raised")
        assert not multiprocessing.active_children() and time.monotonic() - began < 10
    """)


@pytest.mark.parametrize(
    "begin",
    [
        "threading.Thread(target=time.sleep, args=(5,), daemon=True).start()",
        "multiprocessing.parent_process = lambda: object()",
        "os.sched_getaffinity = lambda _: {0}",
    ],
    ids=["a thread that may hold a lock", "a helper itself", "one core"],
)
def test_no_helper_where_forking_is_not_safe_or_not_worth_it(begin: str):
    assert "alone" in ran(f"""
        {begin}
        assert set(at_once(lambda _: os.getpid(), range(50))) == {{me}}
        print("alone")
    """)


def test_a_diagnosis_is_the_same_on_one_core_and_on_two():
    program = """
        import json, sys
        sys.path.insert(0, "tests")
        from hidden.generator import make
        from invid.diagnosis import diagnosis_to_json
        from invid.discrepancy import diagnose
        recording, _ = make("coulomb_friction", seed=3, target_db=20.0, motors=2)
        print(json.dumps(diagnosis_to_json(diagnose(recording)), default=str, sort_keys=True))
    """
    assert ran(program, cores=1) == ran(program)
