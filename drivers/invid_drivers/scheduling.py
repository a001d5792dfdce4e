"""What a real-time loop asks of the system: priority, and memory that stays where it is."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import threading
from collections.abc import Iterator

_MCL_CURRENT_AND_FUTURE = 3
PROBE_PRIORITY = 45
"""SCHED_FIFO priority of a probe: as the cycle's, but below one that may be running beside it."""


def lock_memory() -> bool:
    """Keep all pages of this process in memory, for one that was taken away costs a disk access; whether the
    system allows it."""
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if os.geteuid() != 0 and soft != resource.RLIM_INFINITY:
        return False
    with contextlib.suppress(OSError, AttributeError):
        return bool(ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT_AND_FUTURE) == 0)
    return False


@contextlib.contextmanager
def priority(level: int = PROBE_PRIORITY) -> Iterator[bool]:
    """Give this thread SCHED_FIFO meanwhile and yield whether the system allows it: the cycle has it too."""
    thread = threading.get_native_id()
    try:
        before, given = os.sched_getscheduler(thread), os.sched_getparam(thread)
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(level))
    except (OSError, AttributeError):
        yield False
        return
    try:
        yield True
    finally:
        os.sched_setscheduler(thread, before, given)
