"""Drives over CAN: adapters, CiA 402, the simulated cell, and the process of a run.

python-can (4.6.1, ``can/io/mf4.py``) imports asammdf and with it pandas whenever it is imported, for the
reader and writer of one kind of log: 0.6 s of processor for every process that opens a bus. It does without
them where asammdf is not to be found; ``can_log.frames`` loads them where there is such a file. Whoever
writes MF4 by python-can in the same process imports ``can`` first.
"""

from __future__ import annotations

import sys
from importlib import import_module

if not {"can", "asammdf"} & sys.modules.keys():
    sys.modules["asammdf"] = None  # type: ignore[assignment]
    import_module("can")
    del sys.modules["asammdf"]
