"""Memory that stays where it is: a page that the system took away costs a real-time loop a disk access."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource

_MCL_CURRENT_AND_FUTURE = 3


def lock_memory() -> bool:
    """Keep all pages of this process in memory; whether the system allows it."""
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if os.geteuid() != 0 and soft != resource.RLIM_INFINITY:
        return False
    with contextlib.suppress(OSError, AttributeError):
        return bool(ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT_AND_FUTURE) == 0)
    return False
