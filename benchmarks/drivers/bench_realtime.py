"""Real-time measurement at 1 kHz over three axes: `invid simcell` in one process, the cycle in another.

    python benchmarks/drivers/bench_realtime.py [--minutes 30] [--cycle 0.001]

Both ask for SCHED_FIFO; the output says whether they got it, and how much of the processors the host of a
virtual machine took for itself, against which no priority helps. Prints the share of skipped SYNC slots,
the closest two SYNCs (a burst would show here), the histogram of lateness, lost TPDOs, and how the resident
memory of the three processes grows. The exit status is 1 where a bar is missed: 0.5 % of the slots skipped,
two SYNCs closer than 0.4 cycles, memory that grows by more than 1 MiB in ten minutes.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
import yaml

from invid.recording import read_recording

CONFIG = Path(__file__).parents[2] / "configs" / "case-study-unix.yaml"
INVID = [sys.executable, "-m", "invid"]
PERIOD_S = 8.192
MOST_SKIPPED = 0.005
CLOSEST_CYCLES = 0.4
"""Half a cycle by design; a tenth for the time between reading the clock and sending."""
MOST_GROWTH_MIB = 1.0
"""Per ten minutes. What a run keeps by design (its histogram, its last block of rows) does not grow."""
WARM_S = 30.0
"""Memory is judged from here on: import, compiled code and the first blocks come before."""


def start(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """A command in a process of its own, its stderr in a file named after it."""
    with (folder / f"{arguments[0]}.txt").open("w") as said:
        return subprocess.Popen(
            [*INVID, *arguments], stdout=subprocess.PIPE, stderr=said, text=True, cwd=folder,
            env={**os.environ, "XDG_STATE_HOME": str(folder / "state")},
        )  # fmt: skip


def resident(pid: int) -> float:
    """Resident memory of a process [MiB]."""
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


def stolen() -> float:
    """Seconds that the host took from all processors of this (virtual) machine since it started."""
    fields = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()
    return int(fields[8]) / os.sysconf("SC_CLK_TCK")


def growth(rows: list[tuple[float, float]]) -> float:
    """MiB in ten minutes: the slope of a line through the samples after warming up."""
    t, m = np.array(rows).T
    late = t > min(WARM_S, 0.5 * float(t[-1]))
    return float(np.polyfit(t[late], m[late], 1)[0] * 600) if late.sum() > 2 else 0.0


def run(folder: Path, minutes: float, cycle_s: float) -> list[str]:
    """Measure, watch and print; the bars that were missed, in words."""
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    data["bus"] |= {"channel": str(folder / "bus.sock"), "cycle_s": cycle_s}
    periods = max(2, round(minutes * 60 / 3 / PERIOD_S))
    # Half the usual amplitude: timing is measured here, and half an hour must not end at a limit.
    data["experiments"] = [
        {"kind": "multisine", "period_s": PERIOD_S, "periods": periods, "seed": 1, "amplitude": 0.35}
    ]
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    memory: dict[str, list[tuple[float, float]]] = defaultdict(list)
    simcell = start(folder, "simcell", str(path), "--json")
    try:
        while "ready" not in (folder / "simcell.txt").read_text() and simcell.poll() is None:
            time.sleep(0.02)
        measure = start(folder, "measure", str(path), "-o", "run.h5", "--json")
        began, taken = time.monotonic(), stolen()
        while measure.poll() is None:
            with contextlib.suppress(OSError, IndexError):  # a process that has gone, or is not there yet
                now = time.monotonic() - began
                memory["simcell"].append((now, resident(simcell.pid)))
                memory["measure"].append((now, resident(measure.pid)))
                child = Path(f"/proc/{measure.pid}/task/{measure.pid}/children").read_text().split()[0]
                memory["cycle"].append((now, resident(int(child))))
            time.sleep(2.0)
        steal = (stolen() - taken) / (time.monotonic() - began) / (os.cpu_count() or 1)
    finally:
        simcell.send_signal(signal.SIGINT)
        cell = json.loads(simcell.communicate(timeout=30)[0])
    if measure.returncode != 0:
        raise SystemExit(f"measure ended with {measure.returncode}: {(folder / 'measure.txt').read_text()}")
    result = json.loads(measure.communicate()[0])
    gaps = np.concatenate([np.diff(e.time) for e in read_recording(folder / "run.h5").experiments])
    closest, counts = float(gaps.min()) / cycle_s, result["jitter_histogram"]
    slots = sum(counts.values()) + result["skipped_slots"]
    skipped = result["skipped_slots"] / slots
    print(
        f"{result['duration_s'] / 60:.1f} minutes at {1 / cycle_s:.0f} Hz, three axes, {result['outcome']}; "
        f"load {os.getloadavg()[2]:.1f} on {os.cpu_count()} cores, of which the host took {steal:.1%}; "
        f"SCHED_FIFO for the simulated cell {'granted' if cell['realtime'] else 'not granted'}"
    )
    print(f"skipped {result['skipped_slots']} of {slots} slots; TPDOs missed {result['missed_tpdos']}")
    print("SYNC late by " + ", ".join(f"{k} {v:.0f} µs" for k, v in result["jitter_us"].items()))
    print("\n".join(f"  ≤ {bound:>10}  {n:>9}" for bound, n in counts.items()))
    print("\n".join(f"note: {w}" for w in result["warnings"]))
    bars = {
        f"{skipped:.3%} of the slots skipped, bar {MOST_SKIPPED:.1%}": skipped < MOST_SKIPPED,
        f"closest two SYNCs {closest:.2f} cycles, bar {CLOSEST_CYCLES}": closest >= CLOSEST_CYCLES,
    }
    for name, rows in memory.items():
        grown = growth(rows)
        bars[f"memory of {name} {rows[-1][1]:.0f} MiB, {grown:+.2f} in 10 min"] = grown <= MOST_GROWTH_MIB
    print("\n".join(words + ("" if held else ": MISSED") for words, held in bars.items()))
    return [words for words, held in bars.items() if not held]


def main() -> int:
    """Run and print; the exit status is 1 where a bar was missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--cycle", type=float, default=0.001, help="SYNC period [s]")
    arguments, _ = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as folder:
        return int(bool(run(Path(folder), arguments.minutes, arguments.cycle)))


if __name__ == "__main__":
    sys.exit(main())
