"""Cells whose physics is MuJoCo's (``tests/machines/mujoco_cells.py``): what the diagnosis names of them.

python benchmarks/diagnosis/bench_mujoco.py 1:21 -o mujoco.jsonl [--budget 60]
python benchmarks/diagnosis/bench_mujoco.py --table mujoco.jsonl

A line of JSON a cell, with its seed; the table is that of ``bench_cells.py``, then what each kind of element
was called, then the cells with nothing hidden, then every cell with something missed or named wrongly.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent))

from bench_cells import LOUD, add_lines, row
from machines.mujoco_cells import SIZES, drawn, measured, write
from machines.mujoco_score import scored, with_strengths

import invid
from invid.model.diagnosis_document import diagnosis_to_json
from invid.numerics.run_clock import RunClock


def one(seed: int, budget: float, folder: Path) -> dict[str, Any]:
    """The score of one cell, or what went wrong."""
    cell = drawn(seed)
    runs = measured(cell)
    cell, path = with_strengths(cell, runs), folder / f"{seed}.h5"
    write(cell, runs, path)
    begun, cpu, clock = time.monotonic(), sum(os.times()[:4]), RunClock()
    try:
        document = diagnosis_to_json(invid.diagnose(invid.read_recording(path), budget=budget))
        out = scored(cell, document)
    except invid.InvidError as error:
        out = {"seed": seed, "motion": cell.motion, "error": str(error)}
        out["hidden"] = [(h.kind, cell.axes[h.axis], h.element, round(h.db, 1)) for h in cell.hidden]
    out["budget"] = budget
    out["overrun"] = round(clock() / budget - 1.0, 3)
    out["cpu_s"] = round(sum(os.times()[:4]) - cpu, 1)
    out["wall_s"] = round(time.monotonic() - begun, 1)
    return out


def table(cells: list[dict[str, Any]]) -> None:
    """The figures, the confusion and every cell that is not right."""
    for name, value in row(cells).items():
        if not name.startswith(("friction", "weights")):
            print(f"{name}: {value}")
    done = [c for c in cells if "error" not in c]
    null = [c for c in done if not c["faults"]]
    print(f"nothing hidden, consistent: {sum(c['verdict'] == 'consistent' for c in null)} of {len(null)}")
    print("\nfrom 10 dB | named | not named, and what was")
    for kind in SIZES:
        here = [(f, c) for c in done for f in c["faults"] if f[0] == kind and f[3] >= LOUD]
        missed = Counter(w.rsplit(" ", 1)[0] for f, c in here if not f[4] for w in c["wrong"] or ["nothing"])
        print(f"{kind} | {sum(f[4] for f, _ in here)} of {len(here)} | {dict(missed) or ''}")
    print("\nseed | motion | verdict | hidden (dB, named) | named wrongly | floors")
    for c in cells:
        if "error" in c:
            print(f"{c['seed']} | {c['motion']} | error: {c['error']} | {c['hidden']}")
        elif c["wrong"] or any(f[3] >= LOUD and not f[4] for f in c["faults"]):
            print(
                f"{c['seed']} | {c['motion']} | {c['verdict']} | {c['faults']} | {c['wrong']} | {c['floors']}"
            )


def main() -> None:
    """Runs or tabulates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="?", default="1:11", help="first:last+1")
    parser.add_argument("-o", "--out", type=Path, default=Path("mujoco.jsonl"))
    parser.add_argument("--budget", type=float, default=60.0)
    parser.add_argument("--table", type=Path, help="JSON lines to tabulate")
    args = parser.parse_args()
    if args.table is None:
        first, last = (int(n) for n in args.seeds.split(":"))
        with tempfile.TemporaryDirectory() as folder:
            add_lines(args.out, (one(seed, args.budget, Path(folder)) for seed in range(first, last)))
    table([json.loads(line) for line in (args.table or args.out).read_text().splitlines()])


if __name__ == "__main__":
    main()
