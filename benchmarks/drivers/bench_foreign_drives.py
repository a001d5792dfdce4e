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
        raise SystemExit("no such kind in that phase with so many loads")
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
    outcome = _campaign[0].run(kind, phase, loads, seed)
    v = outcome.verdict
    at = "" if phase == ALWAYS else f" at {outcome.draft.at:.2f} s"
    said = [] if outcome.run is None or v.word == "OK" else outcome.run.words.strip().splitlines()[-1:]
    return {
        "n": n, "kind": kind, "phase": phase, "word": v.word, "stop_s": v.stop_s, "end_s": v.end_s,
        "line": f"{v.word:<9} {n:>3} {kind} / {phase} / {loads}{at} (seed {seed}): "
        + " | ".join([v.note, *(f"BAD {b}" for b in v.bad), *(w[:160] for w in said)]),
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """Kind against phase: violations (v) and refusals (r) of runs."""
    columns = [*PHASES, ALWAYS, "all"]
    out = [["violations + refused / runs", *columns], ["---"] * (len(columns) + 1)]
    for kind in [*dict.fromkeys(r["kind"] for r in rows), "all"]:
        out.append([kind])
        for column in columns:
            own = [
                r["word"] for r in rows
                if kind in (r["kind"], "all") and column in (r["phase"], "all") and r["word"] != "MISSED"
            ]  # fmt: skip
            refused = f"+{own.count('REFUSED')}r" if "REFUSED" in own else ""
            out[-1].append(f"{own.count('VIOLATION')}{refused}/{len(own)}" if own else "")
    return "\n".join(f"| {' | '.join(row)} |" for row in out)


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
    parser.add_argument(
        "--keep", type=Path, help="keep spec, config, trace and events of each run in this folder"
    )
    wished = parser.parse_args()
    if wished.keep:
        wished.keep.mkdir(parents=True, exist_ok=True)
    kept = wished.results
    rows = [json.loads(x) for x in kept.read_text().splitlines()] if kept and kept.exists() else []
    done = {row["n"] for row in rows}
    todo = [j for j in jobs(wished) if j[0] not in done]
    with ProcessPoolExecutor(wished.jobs) as pool:
        for row in pool.map(run_one, todo, [wished.keep] * len(todo)):
            rows.append(row)
            print(row["line"], flush=True)
            if kept:
                with kept.open("a") as out:
                    out.write(json.dumps(row) + "\n")
    print(table(rows))
    for what in ("stop_s", "end_s"):
        longest = max((r[what] for r in rows if r["stop_s"] is not None and r[what] is not None), default=0.0)
        print(
            f"from a person's stop, longest {what}: {longest:.2f} (the command ends within {STOPPED_S:.0f} s)"
        )
    words = {w: sum(r["word"] == w for r in rows) for w in ("OK", "VIOLATION", "REFUSED", "MISSED")}
    print(f"{len(rows)} runs: " + ", ".join(f"{n} {w}" for w, n in words.items()))
    return 1 if words["VIOLATION"] or words["REFUSED"] else 0


if __name__ == "__main__":
    sys.exit(main())
