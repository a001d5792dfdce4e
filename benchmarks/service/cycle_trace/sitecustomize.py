"""Python imports this by itself where its folder is in PYTHONPATH: who made the cycle late.

Beside every slot that the cycle skips stands how long its thread waited for a core meanwhile, as the kernel
counted it (``/proc/…/schedstat``). A thread that nothing in this machine kept from running was late because
the machine did not run: its host had taken the processor away. One JSON document for each cycle process, in
the folder that INVID_CYCLE_TRACE names.
"""

from __future__ import annotations

import atexit
import json
import os
import sys
import threading
from pathlib import Path
from typing import Any


def watch(folder: Path) -> None:
    """Look over the shoulder of ``Cycle``: the slots skipped, and those only because it waited for a core."""
    from invid_drivers.cia402.cycle import CLOSEST_CYCLES, Cycle

    seen = {"late": 0, "waiting": 0, "listening": 0}
    wait_for_slot, listen = Cycle._wait_for_slot, Cycle._listen
    kernel: list[int] = []
    waited_before = 0.0

    def waited() -> float:
        if not kernel:
            kernel.append(os.open(f"/proc/self/task/{threading.get_native_id()}/schedstat", os.O_RDONLY))
        return int(os.pread(kernel[0], 64, 0).split()[1]) / 1e9

    def traced_wait(self: Cycle) -> tuple[int, float, float]:
        nonlocal waited_before
        skipped_before = self.skipped_slots
        if not kernel:
            waited_before = waited()  # before the first slot: importing, configuring the drives
        found = wait_for_slot(self)
        now, skipped = waited(), self.skipped_slots - skipped_before
        if skipped:
            late = found[2] - found[1] + skipped * self._cycle
            seen["late"] += skipped
            # Without that wait it would have been in time.
            seen["waiting"] += skipped * (late - (now - waited_before) <= CLOSEST_CYCLES * self._cycle)
        waited_before = now
        return found

    def traced_listen(self: Cycle) -> None:
        before = self.skipped_slots
        listen(self)
        seen["listening"] += self.skipped_slots - before

    traced: Any = Cycle
    traced._wait_for_slot, traced._listen = traced_wait, traced_listen
    atexit.register(lambda: (folder / f"{os.getpid()}.json").write_text(json.dumps(seen)))


if "INVID_CYCLE_TRACE" in os.environ and "invid_drivers.realtime" in sys.orig_argv:
    watch(Path(os.environ["INVID_CYCLE_TRACE"]))
