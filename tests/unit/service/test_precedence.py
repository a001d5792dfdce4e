"""Who comes first on a busy computer."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

HERE = os.nice(0)


def nice_after(calls: str) -> int:
    """Nice value of a child of this process after the calls."""
    program = f"import os; from invid_service import precedence as p; {calls}; print(os.nice(0))"
    return int(subprocess.run([sys.executable, "-c", program], capture_output=True, check=True).stdout)


@pytest.mark.skipif(HERE > 14, reason="there is nothing left to give way by")
def test_what_computes_gives_way_to_a_service_without_precedence() -> None:
    assert nice_after("p.behind_parent()") == HERE + 5
    assert nice_after("os.nice(3); p.behind_parent()") == HERE + 3, "it gave way already"


def may_come_first() -> bool:
    """Root of a container may not."""
    program = [sys.executable, "-c", "import os; os.setpriority(os.PRIO_PROCESS, 0, -10)"]
    return subprocess.run(program, capture_output=True).returncode == 0


@pytest.mark.skipif(not may_come_first(), reason="the system does not allow it")
def test_a_service_that_comes_before_others_does_not_bequeath_it_to_its_computations() -> None:
    assert nice_after("p.before_others()") == -10
    assert nice_after("p.before_others(); p.as_everyone(); p.behind_parent()") == (0 if HERE < 0 else 5)


def test_without_permission_the_service_goes_on_as_everyone() -> None:
    refuse = "p.os.setpriority = lambda *_: (_ for _ in ()).throw(PermissionError())"
    assert nice_after(f"{refuse}; p.before_others()") == HERE
