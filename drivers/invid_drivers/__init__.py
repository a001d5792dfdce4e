"""Drives over CAN: adapters, CiA 402, the simulated cell, and the process of a run."""

from __future__ import annotations

import sys
from importlib import import_module


def _load_can_without_mf4() -> None:
    """Load python-can without its reader and writer of MF4.

    For them python-can (4.6.1, ``can/io/mf4.py``) imports asammdf and with it pandas whenever it is imported:
    0.6 s of processor for every process that opens a bus. Without asammdf it does without them;
    ``can_log_frames`` loads them where there is such a file.
    """
    if "can" in sys.modules or "asammdf" in sys.modules:
        return
    sys.modules["asammdf"] = None  # type: ignore[assignment]
    try:
        import_module("can")
    finally:
        del sys.modules["asammdf"]


_load_can_without_mf4()
