"""What campaigns share: runs that go on where they were broken off, tables, workers."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

STATUSES = {0: "done (0)", 2: "refused (2)", 4: "safety (4)", 5: "bus/drive (5)"}


def resumed(
    runs: int,
    one: Callable[[int, Path], Any],
    made: Callable[..., Any],
    *,
    seed: int,
    results: Path | None = None,
    seconds: float = float("inf"),
) -> list[Any]:
    """Outcomes of ``one`` for the numbers below ``runs``; fewer when ``seconds`` are over.

    Those that stand in ``results`` are not run again; ``made`` is their class, with ``complaints``.
    """
    outcomes = []
    if results is not None and results.exists():
        rows = [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()]
        if any(row.pop("seed") != seed for row in rows):
            raise SystemExit(f"{results}: holds runs of another seed than {seed}; name another file")
        outcomes = [
            made(**{k: tuple(v) if isinstance(v, list) else v for k, v in row.items()}) for row in rows[:runs]
        ]
    started = time.monotonic()
    for n in range(len(outcomes), runs):
        if time.monotonic() - started > seconds:
            break
        with tempfile.TemporaryDirectory() as folder:
            outcomes.append(one(n, Path(folder)))
        if results is not None:
            with results.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"seed": seed, **asdict(outcomes[-1])}) + "\n")
    return outcomes


def aligned(rows: Sequence[Sequence[str]], *, markdown: bool = False) -> str:
    """A table whose first row is its head."""
    widths = [max(len(r[i]) for r in rows) for i in range(len(rows[0]))]
    lines = [" | ".join(c.ljust(w) for c, w in zip(r, widths, strict=True)) for r in rows]
    if markdown:
        lines = [f"| {line} |" for line in lines]
        lines.insert(1, "|" + " --- |" * len(widths))
    return "\n".join(lines)


def judged_runs(
    description: str | None,
    kinds: Iterable[str],
    run_one: Callable[[str, np.random.Generator, Path], Any],
    made: Callable[..., Any],
) -> int:
    """Run a campaign by the command line, kinds in turn, and print its table; 1 where anything was violated.

    An outcome has ``kind``, ``status``, ``excess`` and ``complaints``; each run draws from a seed of its own.
    """
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so long")
    parser.add_argument("--kind", choices=sorted(kinds), help="this kind alone")
    parser.add_argument("--markdown", action="store_true")
    parser.add_argument("--results", type=Path, help="keep each run in this file and resume from it")
    given, _ = parser.parse_known_args()
    chosen, started = [given.kind] if given.kind else list(kinds), time.monotonic()

    def one(n: int, folder: Path) -> Any:
        return run_one(chosen[n % len(chosen)], np.random.default_rng([given.seed, n]), folder)

    outcomes = resumed(given.runs, one, made, seed=given.seed, results=given.results, seconds=given.seconds)
    groups: dict[str, list[Any]] = defaultdict(list)
    for o in outcomes:
        groups[o.kind].append(o)
    rows: list[tuple[str, ...]] = [("kind", "runs", *STATUSES.values(), "worst excess", "violations")]
    for kind, group in groups.items():
        counts = [str(sum(o.status == s for o in group)) for s in STATUSES]
        bad = sum(bool(o.complaints) for o in group)
        rows.append((kind, str(len(group)), *counts, f"{max(o.excess for o in group):.2f}", str(bad)))
    print(aligned(rows, markdown=given.markdown))
    failed = [(n, o) for n, o in enumerate(outcomes) if o.complaints]
    for n, o in failed[:40]:
        print(f"run {n} ({o.kind}, exit {o.status}): {'; '.join(o.complaints)}")
    print(
        f"{len(outcomes)} runs, {len(failed)} violations, {time.monotonic() - started:.0f} s; worst excess: "
        "the way beyond the window as a share of what reaction and stop allow"
    )
    return 1 if failed else 0


def each(jobs: Sequence[Any], task: Callable[[Any], Any], keep: Callable[[Any], None], workers: int) -> None:
    """Hand what ``task`` makes of every job to ``keep``; in several processes where that is wanted."""
    if workers > 1:
        with multiprocessing.get_context("spawn").Pool(workers) as pool:
            for row in pool.imap_unordered(task, jobs):
                keep(row)
    else:
        for job in jobs:
            keep(task(job))
