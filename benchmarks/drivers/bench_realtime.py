"""Real-time measurement at 1 kHz over three axes: `invid simcell` in one process, the cycle in another.

    python benchmarks/drivers/bench_realtime.py [--minutes 30] [--cycle 0.001] [--json]

Both ask for SCHED_FIFO; the output says whether they got it, and how much of the processors the host of a
virtual machine took for itself, against which no priority helps. Prints the share of skipped SYNC slots, the
closest two SYNCs (a burst would show here), the histogram of lateness, lost TPDOs, and the resident memory of
the three processes over time, beside the machine's load. The exit status is 1 where a bar is missed: 0.5 % of
the slots skipped, two SYNCs closer than 0.4 cycles, memory that grows by more than 1 MiB in ten minutes.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.shared.processes import children, start, wait_for
from invid.recording import read_recording

CONFIG = Path(__file__).parents[2] / "configs" / "case-study-unix.yaml"
PERIOD_S = 8.192
LEAST_MINUTES = 0.5
MOST_SKIPPED = 0.005
CLOSEST_CYCLES = 0.4
"""Half a cycle by design; a tenth for the time between reading the clock and sending."""
MOST_GROWTH_MIB = 1.0
"""Per ten minutes. What a run keeps by design (its histogram, its last block of rows) does not grow."""
WARM_S = 30.0
"""Memory is judged from here on: import, compiled code and the first blocks come before."""


@dataclass
class Watched:
    """A process and its resident memory over time."""

    name: str
    pid: int
    seconds: list[float] = field(default_factory=list)
    mib: list[float] = field(default_factory=list)

    def look(self, now: float) -> None:
        """One sample; nothing where the process has gone."""
        try:
            for line in Path(f"/proc/{self.pid}/status").read_text().splitlines():
                if line.startswith("VmRSS:"):
                    self.seconds.append(now)
                    self.mib.append(int(line.split()[1]) / 1024)
        except OSError:
            pass

    def growth(self) -> float:
        """MiB in ten minutes: the slope of a line through the samples after warming up."""
        t, m = np.array(self.seconds), np.array(self.mib)
        late = t > min(WARM_S, 0.5 * float(t[-1]))
        return float(np.polyfit(t[late], m[late], 1)[0] * 600) if late.sum() > 2 else 0.0


def cell_config(folder: Path, minutes: float, cycle_s: float) -> Path:
    """The case study; three runs of orthogonal multisines that fill the minutes."""
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    data["bus"] |= {"channel": str(folder / "bus.sock"), "cycle_s": cycle_s}
    periods = max(2, round(minutes * 60 / 3 / PERIOD_S))
    # Half the usual amplitude: timing is measured here, and half an hour must not end at a limit.
    data["experiments"] = [
        {"kind": "multisine", "period_s": PERIOD_S, "periods": periods, "seed": 1, "amplitude": 0.35}
    ]
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path


def stolen() -> float:
    """Seconds that the host took from all processors of this (virtual) machine since it started."""
    fields = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()
    return int(fields[8]) / os.sysconf("SC_CLK_TCK")


def run(folder: Path, minutes: float, cycle_s: float) -> dict[str, Any]:
    """The measurement, watched; a document of figures."""
    path = cell_config(folder, minutes, cycle_s)
    simcell = start(folder, "simcell", str(path), "--json", errors="simcell.txt")
    loads = [os.getloadavg()[0]]
    try:
        wait_for(simcell, folder / "simcell.txt", "ready", 120)
        measure = start(folder, "measure", str(path), "-o", "run.h5", "--json", errors="measure.txt")
        began, taken = time.monotonic(), stolen()
        watched = [Watched("parent", measure.pid), Watched("simcell", simcell.pid)]
        while measure.poll() is None:
            if len(watched) == 2 and (found := children(measure.pid)):
                watched.append(Watched("cycle", found[0]))
            for w in watched:
                w.look(time.monotonic() - began)
            loads.append(os.getloadavg()[0])
            time.sleep(2.0)
        out = measure.communicate()[0]
        steal = (stolen() - taken) / (time.monotonic() - began) / (os.cpu_count() or 1)
    finally:
        simcell.send_signal(signal.SIGINT)
        said = simcell.communicate(timeout=30)[0]
    if measure.returncode != 0:
        raise SystemExit(f"measure ended with {measure.returncode}: {(folder / 'measure.txt').read_text()}")
    result, cell = json.loads(out), json.loads(said)
    return _figures(folder / "run.h5", result, cell, watched, loads, steal, cycle_s)


def _figures(
    path: Path,
    result: dict[str, Any],
    cell: dict[str, Any],
    watched: list[Watched],
    loads: list[float],
    steal: float,
    cycle_s: float,
) -> dict[str, Any]:
    recording = read_recording(path)
    rows = sum(e.samples for e in recording.experiments)
    gaps = np.concatenate([np.diff(e.time) for e in recording.experiments])
    slots = sum(result["jitter_histogram"].values()) + result["skipped_slots"]
    return {
        "minutes": result["duration_s"] / 60,
        "cycle_s": cycle_s,
        "outcome": result["outcome"],
        "slots": slots,
        "skipped_slots": result["skipped_slots"],
        "skipped_share": result["skipped_slots"] / slots,
        "missed_tpdos": result["missed_tpdos"],
        "rows": rows,
        "closest_syncs_cycles": float(gaps.min()) / cycle_s,
        "jitter_us": result["jitter_us"],
        "jitter_histogram": result["jitter_histogram"],
        "realtime": not any("SCHED_FIFO" in w for w in result["warnings"]),
        "simcell_realtime": cell["realtime"],
        "simcell_late_max_s": cell["late_max_s"],
        "load": {
            "median": float(np.median(loads)),
            "worst": max(loads),
            "cores": os.cpu_count(),
            "stolen": steal,
        },
        "memory": [
            {
                "process": w.name,
                "growth_MiB_per_10_min": w.growth(),
                "MiB": [round(m, 1) for m in w.mib[:: max(1, len(w.mib) // 10)]],
                "seconds": [round(s) for s in w.seconds[:: max(1, len(w.mib) // 10)]],
            }
            for w in watched
        ],
        "warnings": result["warnings"],
    }


def judge(figures: dict[str, Any]) -> list[str]:
    """The bars that were missed, in words."""
    missed = []
    if figures["skipped_share"] >= MOST_SKIPPED:
        missed.append(f"{figures['skipped_share']:.2%} of the slots were skipped, bar {MOST_SKIPPED:.1%}")
    if figures["closest_syncs_cycles"] < CLOSEST_CYCLES:
        missed.append(f"two SYNCs {figures['closest_syncs_cycles']:.2f} cycles apart: a burst")
    for memory in figures["memory"]:
        if memory["growth_MiB_per_10_min"] > MOST_GROWTH_MIB:
            missed.append(
                f"memory of {memory['process']} grows by {memory['growth_MiB_per_10_min']:.1f} MiB in 10 min"
            )
    return missed


def text(figures: dict[str, Any], missed: list[str]) -> str:
    """For a person."""
    f, load = figures, figures["load"]
    lines = [
        f"{f['minutes']:.1f} minutes at {1 / f['cycle_s']:.0f} Hz, three axes, {f['outcome']}; load of the "
        f"machine {load['median']:.1f} (median) {load['worst']:.1f} (worst) on {load['cores']} cores; "
        f"the host took {load['stolen']:.1%} of them; SCHED_FIFO for the cycle "
        f"{'granted' if f['realtime'] else 'not granted'}, for the simulated cell "
        f"{'granted' if f['simcell_realtime'] else 'not granted'}",
        f"skipped slots {f['skipped_slots']} of {f['slots']} ({f['skipped_share']:.3%}); closest two SYNCs "
        f"{f['closest_syncs_cycles']:.2f} cycles; TPDOs missed {f['missed_tpdos']}",
        "SYNC late by " + ", ".join(f"{k} {v:.0f} µs" for k, v in f["jitter_us"].items()),
    ]
    counts = f["jitter_histogram"]
    total, seen = sum(counts.values()), 0
    for bound, n in counts.items():
        seen += n
        lines.append(f"  ≤ {bound:>10}  {n:>9}  {seen / total:8.4%}")
    for m in f["memory"]:
        series = " ".join(f"{s}s:{v:.0f}" for s, v in zip(m["seconds"], m["MiB"], strict=True))
        lines.append(f"memory of {m['process']} [MiB] {series}; {m['growth_MiB_per_10_min']:+.2f} in 10 min")
    lines += [f"note: {w}" for w in f["warnings"]]
    lines += [f"MISSED: {m}" for m in missed] or ["all bars held"]
    return "\n".join(lines)


def main() -> int:
    """Run and print; the exit status is 1 where a bar was missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--cycle", type=float, default=0.001, help="SYNC period [s]")
    parser.add_argument("--json", action="store_true")
    arguments, _ = parser.parse_known_args()
    if arguments.minutes < LEAST_MINUTES:
        parser.error(f"--minutes {arguments.minutes:g}: at least {LEAST_MINUTES:g}")
    with tempfile.TemporaryDirectory() as folder:
        figures = run(Path(folder), arguments.minutes, arguments.cycle)
    missed = judge(figures)
    if arguments.json:
        print(json.dumps({**figures, "missed_bars": missed}, indent=1))
    else:
        print(text(figures, missed))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
