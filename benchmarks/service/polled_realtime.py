"""Slots that a run in real time misses, with and without clients that poll the service; for bench_service.

On two cores the same run misses twice as many slots in one minute as in the next, so both kinds are measured
in pairs, one after the other, and which comes first alternates. What counts is the mean difference within a
pair and how well it is known. Beside it stands whose fault it was (``cycle_trace``): slots that would not
have been missed had nothing in this machine kept the cycle from a core, and all others, in which the machine
itself stood still or the cycle computed.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy import stats
from service_process import Serving, serving

from benchmarks.drivers.bench_realtime import stolen
from benchmarks.service.polling import Load, hammer
from benchmarks.shared.processes import INVID

ROOT = Path(__file__).parents[2]
LONGEST_S = 400.0
LOOK_EVERY_S = 0.5


@dataclass(frozen=True)
class Run:
    """One measurement in real time."""

    skipped: int
    slots: int
    waiting: int
    """Of the skipped ones: only because the cycle, ready to run, waited for a core that somebody else had."""
    listening: int
    """Of the skipped ones: on purpose, to hear whether a late drive has fallen behind."""
    host: float
    """Share of the processors that the host took."""
    load: Load | None

    @property
    def share(self) -> float:
        """Of the slots that were skipped."""
        return self.skipped / self.slots

    def __str__(self) -> str:
        polled = "not polled" if self.load is None else f"polled, {self.load}"
        return (
            f"real time, {polled}: {self.skipped} of {self.slots} slots ({self.share:.2%}) skipped, "
            f"{self.waiting} of them for want of a core, {self.listening} on purpose; the host took "
            f"{self.host:.1%} of the processors, load {os.getloadavg()[0]:.1f}"
        )


def realtime(pairs: int) -> bool:
    """Whether polling is not seen to add missed slots; against `invid simcell` in its own process."""
    runs: dict[bool, list[Run]] = {False: [], True: []}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = realtime_cell(folder)
        with (folder / "simcell.txt").open("w") as said:
            simcell = subprocess.Popen(
                [*INVID, "simcell", str(folder / "cell.yaml")], stdout=said, stderr=said, cwd=folder
            )
        try:
            with serving(folder, cell=config, env=traced(folder)) as service:
                for n in range(2 * pairs):
                    polled = n % 4 in (1, 2)
                    runs[polled].append(measured(service, polled))
                    print(runs[polled][-1], flush=True)
        finally:
            simcell.send_signal(signal.SIGINT)
            simcell.wait(30)
    without, polled_share = ([r.share for r in runs[k]] for k in (False, True))
    kept = difference("skipped", without, polled_share)
    difference("skipped for want of a core", *([r.waiting / r.slots for r in runs[k]] for k in (False, True)))
    return kept


def difference(what: str, without: list[float], polled: list[float]) -> bool:
    """Print what polling adds to a share of slots; False where it is seen to add some."""
    means = f"{np.mean(without):.3%} of the slots without polling, {np.mean(polled):.3%} with it"
    print(f"real time, {what}: {means}")
    added = np.array(polled) - np.array(without)
    if len(added) < 2:
        return bool(added[0] <= 0)
    half = float(stats.t.ppf(0.975, len(added) - 1) * added.std(ddof=1) / np.sqrt(len(added)))
    print(f"real time, {what}: polling adds {added.mean():+.3%} ± {half:.3%} ({len(added)} pairs, 95 %)")
    return bool(added.mean() - half <= 0)


def traced(folder: Path) -> dict[str, str]:
    """Environment in which the cycle leaves in the folder whose fault its skipped slots were."""
    traces = folder / "traces"
    traces.mkdir()
    return {"PYTHONPATH": str(Path(__file__).with_name("cycle_trace")), "INVID_CYCLE_TRACE": str(traces)}


def measured(service: Serving, polled: bool) -> Run:
    """One run, until its motion has ended."""
    location = service.start()
    service.wait(location, "running", timeout=LONGEST_S)
    ended = threading.Event()
    traces = service.folder / "traces"
    known = set(traces.iterdir())

    def watch() -> None:
        end = time.monotonic() + LONGEST_S
        while service.client.get(location).json()["state"] == "running" and time.monotonic() < end:
            time.sleep(LOOK_EVERY_S)
        ended.set()

    watcher = threading.Thread(target=watch)
    watcher.start()
    began, taken = time.monotonic(), stolen()
    load = hammer(service.url, location, LONGEST_S, ended) if polled else None
    watcher.join()
    host = (stolen() - taken) / (time.monotonic() - began) / (os.cpu_count() or 1)
    seen = service.wait(location, "analysing", "awaiting_accept")["measurement"]
    service.client.post(f"{location}/actions", json={"type": "cancel"})
    skipped, slots = missed_slots(seen)
    (trace,) = set(traces.iterdir()) - known
    whose = json.loads(trace.read_text())
    return Run(skipped, slots, whose["waiting"], whose["listening"], host, load)


def realtime_cell(folder: Path) -> str:
    """The case study over a socket, short; also written for the simulated cell."""
    data = yaml.safe_load((ROOT / "configs" / "case-study-unix.yaml").read_text(encoding="utf-8"))
    data["bus"]["channel"] = str(folder / "bus.sock")
    data["experiments"] = [
        {"kind": "multisine", "period_s": 8.192, "periods": 2, "seed": 1, "amplitude": 0.35, "axes": ["A1"]}
    ]
    text = yaml.safe_dump(data)
    (folder / "cell.yaml").write_text(text, encoding="utf-8")
    return text


def missed_slots(measurement: dict[str, Any]) -> tuple[int, int]:
    """SYNC slots without a SYNC, and all slots, as the cycle counted them: the recording fills its gaps."""
    skipped = int(measurement["skipped_slots"])
    return skipped, sum(measurement["jitter_histogram"].values()) + skipped
