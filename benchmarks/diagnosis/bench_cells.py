"""Whole cells of ``tests/hidden/cells.py``: what the diagnosis names of what is there. A line of JSON a cell.

python benchmarks/diagnosis/bench_cells.py 100:110 -o cells.jsonl [--budgets 5,10,20,60]
python benchmarks/diagnosis/bench_cells.py --table before.jsonl after.jsonl

The table has a column for each file and budget. Processor time is that of the run, its helpers included;
the overrun is of the budget by the clock that keeps it (``invid.numerics.run_clock``).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from hidden.cells import Cell, draw, scored

import invid
from invid.numerics.run_clock import RunClock

LOUD = 10.0
"""Decibels from which on the issue asks for nine names in ten; below, down to none, for eight."""


def one(recording: invid.Recording, truth: Cell, budget: float) -> dict[str, Any]:
    """The score of one cell, or what went wrong."""
    begun, cpu, clock = time.monotonic(), sum(os.times()[:4]), RunClock()
    try:
        out = scored(truth, invid.diagnose(recording, budget=budget))
    except invid.InvidError as error:
        out = {"seed": truth.seed, "error": str(error)}
    out["budget"] = budget
    out["overrun"] = round(clock() / budget - 1.0, 3)
    out["cpu_s"] = round(sum(os.times()[:4]) - cpu, 1)
    out["wall_s"] = round(time.monotonic() - begun, 1)
    return out


def add_lines(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    """Appends JSON lines, each as soon as it is there."""
    with path.open("a") as out:
        for found in rows:
            out.write(json.dumps(found) + "\n")
            out.flush()


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
        "worst overrun of the budget": f"{max(c.get('overrun', 0.0) for c in cells):.0%}",
    }


def main() -> None:
    """Runs or tabulates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="?", default="100:110", help="first:last+1")
    parser.add_argument("-o", "--out", type=Path, default=Path("cells.jsonl"))
    parser.add_argument("--budgets", default="60", help="seconds, each cell with each of them")
    parser.add_argument("--table", type=Path, nargs="+", help="JSON lines to tabulate beside one another")
    args = parser.parse_args()
    if args.table:
        columns = {}
        for path in args.table:
            cells = [json.loads(line) for line in path.read_text().splitlines()]
            for budget in sorted({c["budget"] for c in cells}):
                columns[f"{path.stem}, {budget:g} s"] = row([c for c in cells if c["budget"] == budget])
        print(" | ".join(["", "", *columns, ""]).strip())
        for name in next(iter(columns.values())):
            print(" | ".join(["", name, *(c[name] for c in columns.values()), ""]).strip())
        return
    first, last = (int(n) for n in args.seeds.split(":"))
    budgets = [float(b) for b in args.budgets.split(",")]
    drawn = (draw(seed) for seed in range(first, last))
    add_lines(args.out, (one(*cell, budget) for cell in drawn for budget in budgets))


if __name__ == "__main__":
    main()
