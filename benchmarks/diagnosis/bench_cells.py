"""Whole cells of ``tests/hidden/cells.py``: what the diagnosis names of what is there. A line of JSON a cell.

python benchmarks/diagnosis/bench_cells.py 100:110 -o cells.jsonl [--budget 120]
python benchmarks/diagnosis/bench_cells.py --table before.jsonl after.jsonl
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from hidden.cells import draw, scored

import invid

LOUD = 10.0
"""Decibels from which on the issue asks for nine names in ten; below, down to none, for eight."""


def one(seed: int, budget: float) -> dict[str, Any]:
    """The score of one cell, or what went wrong."""
    recording, truth = draw(seed)
    begun, cpu = time.monotonic(), time.process_time()
    try:
        diagnosis = invid.diagnose(recording, budget=budget)
    except invid.InvidError as error:
        return {"seed": seed, "error": str(error)}
    out = scored(truth, diagnosis)
    out["cpu_s"] = round(time.process_time() - cpu, 1)
    out["wall_s"] = round(time.monotonic() - begun, 1)
    return out


def row(cells: list[dict[str, Any]]) -> dict[str, str]:
    """The figures of a campaign."""
    done = [c for c in cells if "error" not in c]
    faults = [f for c in done for f in c["faults"]]
    loud = [f for f in faults if f[3] >= LOUD]
    quiet = [f for f in faults if 0.0 <= f[3] < LOUD]
    cpu = sorted(c["cpu_s"] for c in done)
    return {
        "cells": f"{len(done)} of {len(cells)}",
        "faults named, from 10 dB": f"{sum(f[4] for f in loud)} of {len(loud)}",
        "faults named, 0 to 10 dB": f"{sum(f[4] for f in quiet)} of {len(quiet)}",
        "friction named, axes": " of ".join(str(sum(c["friction"][k] for c in done)) for k in (0, 1)),
        "weights named": " of ".join(str(sum(c["gravity"][k] for c in done)) for k in (0, 1)),
        "wrong names": f"{sum(len(c['wrong']) for c in done)} of {sum(len(c['named']) for c in done)}",
        "wrong at 0.9 or more": str(sum(len(c["sure_and_wrong"]) for c in done)),
        "silent cells": str(sum(not c["named"] for c in done)),
        "at the floor (1.2)": str(sum(max(c["floors"]) <= 1.2 for c in done)),
        "CPU s, median and most": f"{cpu[len(cpu) // 2]:.0f}, {cpu[-1]:.0f}" if cpu else "",
    }


def main() -> None:
    """Runs or tabulates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="?", default="100:110", help="first:last+1")
    parser.add_argument("-o", "--out", type=Path, default=Path("cells.jsonl"))
    parser.add_argument("--budget", type=float, default=120.0)
    parser.add_argument("--table", type=Path, nargs="+", help="JSON lines to tabulate beside one another")
    args = parser.parse_args()
    if args.table:
        rows = [row([json.loads(line) for line in p.read_text().splitlines()]) for p in args.table]
        for name in rows[0]:
            print(" | ".join(["", name, *(r[name] for r in rows), ""]).strip())
        return
    first, last = (int(n) for n in args.seeds.split(":"))
    with args.out.open("a") as out:
        for seed in range(first, last):
            out.write(json.dumps(one(seed, args.budget)) + "\n")
            out.flush()


if __name__ == "__main__":
    main()
