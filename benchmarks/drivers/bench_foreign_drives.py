"""Kinds of foreign drives x phases x loads in virtual time, judged on the true motion of the plant.

    python benchmarks/drivers/bench_foreign_drives.py --seed 1 --runs 40
    python benchmarks/drivers/bench_foreign_drives.py --seed 1 --kind "lets go in quick stop" --loads 2 3
    FOREIGN_INVID=/path/to/invid python benchmarks/drivers/bench_foreign_drives.py …     # another product

The installed command `invid measure CONFIG --json` runs against CiA 402 drives that share no code with the
product (`tests/machines/foreign`). Every kind meets every phase and 0 to 3 loaded axes that it can; runs go
through them in an order drawn by the seed and then round again with other moments and machines. A line a run:

- VIOLATION: torque above the tightest limit by more than 5 %, travel beyond window and stated room, a loaded
  axis more than 0.02 rad down beyond what is played and what physics lets it, a sentence that is not true or
  one that is missing, a foreign node spoken to, no end, a traceback;
- REFUSED: a healthy cell that was not measured;
- MISSED: the run had ended before anything happened.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT)]

from invid_drivers.cia402.bus import STOPPED_S  # noqa: E402
from tests.machines.foreign.campaign import Campaign  # noqa: E402
from tests.machines.foreign.draft import ALWAYS, PHASES  # noqa: E402
from tests.machines.foreign.kinds import KINDS  # noqa: E402

Job = tuple[int, str, str, int, int]
_campaign: list[Campaign] = []


def jobs(wished: argparse.Namespace) -> Iterator[Job]:
    """Number, kind, phase, loads and seed of each run."""
    cells = [
        (kind, phase, loads)
        for kind, what in KINDS.items()
        for phase in what.phases
        for loads in what.loads
        if (not wished.kind or kind in wished.kind)
        and (not wished.phase or phase in wished.phase)
        and (not wished.loads or loads in wished.loads)
    ]
    if not cells:
        raise SystemExit("no such kind in that phase with so many loads; --list shows them")
    count = wished.runs or len(cells)
    for n in range(count):
        turn, k = divmod(n, len(cells))
        order = list(cells)
        random.Random(f"{wished.seed}/{turn}").shuffle(order)
        yield n, *order[k], wished.seed * 1000 + turn


def run_one(job: Job, keep: Path | None = None) -> dict[str, Any]:
    """One run as a row."""
    if not _campaign:
        _campaign.append(Campaign(keep))
    n, kind, phase, loads, seed = job
    began = time.monotonic()
    outcome = _campaign[0].run(kind, phase, loads, seed)
    v = outcome.verdict
    return {
        "n": n, "kind": kind, "phase": phase, "loads": loads, "seed": seed, "word": v.word,
        "bad": list(v.bad), "note": v.note, "stop_s": v.stop_s, "end_s": v.end_s,
        "at": None if phase == ALWAYS else round(outcome.draft.at, 3),
        "said": [] if outcome.run is None else outcome.run.words.strip().splitlines()[-1:],
        "seconds": round(time.monotonic() - began, 1),
    }  # fmt: skip


def line(row: dict[str, Any]) -> str:
    """A row as a line."""
    where = f"{row['kind']} / {row['phase']} / {row['loads']}"
    at = "" if row["at"] is None else f" at {row['at']:.2f} s"
    bad = "; ".join(row["bad"])
    said = " ".join(row["said"])[:160] if row["word"] != "OK" else ""
    return (
        f"{row['word']:<9} {row['n']:>3} {where}{at} (seed {row['seed']}, {row['seconds']:.0f} s): "
        f"{row['note']}{' | BAD ' + bad if bad else ''}{' | ' + said if said else ''}"
    )


def table(rows: list[dict[str, Any]]) -> str:
    """Kind against phase and loads: violations (v) and refusals (r) of runs."""
    count: dict[tuple[str, str], list[int]] = defaultdict(lambda: [0, 0, 0])
    for row in rows:
        for column in (row["phase"], f"{row['loads']} loads", "all"):
            for kind in (row["kind"], "all"):
                cell = count[kind, column]
                cell[0] += row["word"] == "VIOLATION"
                cell[1] += row["word"] == "REFUSED"
                cell[2] += row["word"] != "MISSED"
    columns = [*PHASES, ALWAYS, *(f"{n} loads" for n in range(4)), "all"]
    out = [
        "| violations + refused / runs | " + " | ".join(columns) + " |",
        "|" + " --- |" * (len(columns) + 1),
    ]
    for kind in [k for k in KINDS if (k, "all") in count] + ["all"]:
        cells = []
        for c in columns:
            v, r, n = count.get((kind, c), (0, 0, 0))
            cells.append((f"{v}{f'+{r}r' if r else ''}/{n}") if n else "")
        out.append(f"| {kind} | " + " | ".join(cells) + " |")
    return "\n".join(out)


def stops(rows: list[dict[str, Any]]) -> str:
    """Longest time from a person's stop to standing, and to the end of the command, by phase."""
    out = ["| stopped in | runs | standing after [s] | ended after [s], bound " + f"{STOPPED_S:.0f} |"]
    out.append("|" + " --- |" * 4)
    for phase in [*PHASES, ALWAYS]:
        own = [r for r in rows if r["phase"] == phase and r.get("stop_s") is not None]
        if own:
            most = [max(r[k] or 0.0 for r in own) for k in ("stop_s", "end_s")]
            out.append(f"| {phase} | {len(own)} | {most[0]:.2f} | {most[1]:.2f} |")
    return "\n".join(out)


def main() -> int:
    """Run, print a line a run and the table; 1 where anything was violated or refused."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, help="default: every kind, phase and number of loads once")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", nargs="*", choices=list(KINDS))
    parser.add_argument("--phase", nargs="*", choices=[*PHASES, ALWAYS])
    parser.add_argument("--loads", nargs="*", type=int, choices=range(4))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--results", type=Path, help="keep each run here (JSON lines), and go on from it")
    parser.add_argument("--only", type=int, nargs="*", help="these numbers of the same draw")
    parser.add_argument(
        "--keep", type=Path, help="keep spec, config, trace and events of each run in this folder"
    )
    parser.add_argument("--list", action="store_true", help="kinds and what they meet")
    parser.add_argument("--table", action="store_true", help="only the table of --results")
    wished = parser.parse_args()
    if wished.list:
        for name, what in KINDS.items():
            doc = " ".join((what.make.__doc__ or "").split())
            healthy = " (healthy)" if what.healthy else ""
            print(f"{name}{healthy}: {doc} [{', '.join(what.phases)}; {what.loads}]")
        return 0
    if wished.keep:
        wished.keep.mkdir(parents=True, exist_ok=True)
    kept = wished.results
    rows = [json.loads(x) for x in kept.read_text().splitlines()] if kept and kept.exists() else []
    done = {row["n"] for row in rows}
    todo = [j for j in jobs(wished) if j[0] not in done and (not wished.only or j[0] in wished.only)]

    def take(row: dict[str, Any]) -> None:
        rows.append(row)
        print(line(row), flush=True)
        if kept:
            with kept.open("a") as out:
                out.write(json.dumps(row) + "\n")

    if wished.table:
        todo = []
    if wished.jobs > 1:
        with ProcessPoolExecutor(wished.jobs) as pool:
            for row in pool.map(run_one, todo, [wished.keep] * len(todo)):
                take(row)
    else:
        for job in todo:
            take(run_one(job, wished.keep))
    print(table(rows))
    print(stops(rows))
    words = {w: sum(r["word"] == w for r in rows) for w in ("OK", "VIOLATION", "REFUSED", "MISSED")}
    print(f"{len(rows)} runs: " + ", ".join(f"{n} {w}" for w, n in words.items()))
    return 1 if words["VIOLATION"] or words["REFUSED"] else 0


if __name__ == "__main__":
    sys.exit(main())
