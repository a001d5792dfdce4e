"""Set who comes first on a busy computer: the cycle (SCHED_FIFO), then the service, then what computes.

A stop that has to wait for somebody's computations comes late. Threads and processes made afterwards inherit
what is set here.
"""

from __future__ import annotations

import contextlib
import os

FIRST = -10
"""Nice value of the service: nine times an ordinary program's share of a core, and woken at once."""
STEP = 5
"""Where the system does not allow that, so much below go the computations: a third of its share. More would
let them starve beside other programs."""


def before_others() -> None:
    """Put the service before others, where the system allows it (root, CAP_SYS_NICE or LimitNICE=-10)."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, min(FIRST, os.getpriority(os.PRIO_PROCESS, 0)))


def as_everyone() -> None:
    """A process of the service that does not answer anybody."""
    os.setpriority(os.PRIO_PROCESS, 0, max(0, os.getpriority(os.PRIO_PROCESS, 0)))


def behind_parent() -> None:
    """One that computes for seconds or minutes gives way to whoever started it."""
    with contextlib.suppress(OSError):
        if os.getpriority(os.PRIO_PROCESS, os.getppid()) >= os.getpriority(os.PRIO_PROCESS, 0):
            os.nice(STEP)
