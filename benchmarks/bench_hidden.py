"""Hidden effects: draws plants, causes, places, sizes, excitation and noise; prints what was found.

    python benchmarks/bench_hidden.py [--trials N] [--start SEED] [--jobs 2] [--kind null] [--cause backlash]
                                      [--db 0 20] [--motors 3] [--json ROWS.jsonl] [--excitation chirp]

Every row of the result can be made again from its seed: `make_case(seed)` in tests/hidden, or
`make(cause, seed=seed, target_db=…)` where --cause or --db is given.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import traceback
from collections import Counter, defaultdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

BINS = ((-99.0, -10.0), (-10.0, 0.0), (0.0, 10.0), (10.0, 99.0))


def trial(job: tuple[int, dict[str, Any]]) -> dict[str, Any]:
    """One case, made and diagnosed."""
    from hidden.generator import make, make_case
    from hidden.scoring import bias, parameter_error, score

    from invid.diagnosis.diagnose import diagnose

    seed, options = job
    shaken = {"motors": options["motors"], "excitation": options["excitation"]}
    if options.get("cause") or options.get("db") is not None:
        rng = np.random.default_rng([seed, 11])
        goal = None if options["db"] is None else float(rng.uniform(*options["db"]))
        recording, truth = make(options["cause"], seed=seed, target_db=goal, **shaken)
    else:
        recording, truth = make_case(seed, kind=options["kind"], **shaken)
    row: dict[str, Any] = {
        "seed": seed,
        "kind": truth.kind,
        "causes": [e.cause for e in truth.effects],
        "places": [f"{e.axis} {e.element or e.other_axis or ''}".strip() for e in truth.effects],
        "sizes": [e.parameters for e in truth.effects],
        "db": truth.db,
        "masses": truth.settings["masses"],
        "settings": truth.settings,
    }
    started, cpu = time.perf_counter(), time.process_time()
    try:
        diagnosis = diagnose(recording)
    except Exception as error:
        return {
            **row,
            "outcome": "crash",
            "named": f"{type(error).__name__}: {error}",
            "trace": traceback.format_exc(limit=-3),
            "seconds": time.perf_counter() - started,
            "cpu": 0.0,
        }
    row["seconds"], row["cpu"] = time.perf_counter() - started, time.process_time() - cpu
    result = score(truth, diagnosis)
    row |= {
        "outcome": result.outcome,
        "named": result.named,
        "found": [
            f"{f.effect.cause}@{f.effect.axis} {f.effect.element or f.effect.other_axis or ''} "
            f"{ {k: float(f'{v.value:.4g}') for k, v in f.effect.parameters.items()} } {f.confidence:.2f} "
            f"alt {[a.cause + '@' + a.axis + ' ' + str(a.element) for a in f.alternatives]}"
            for f in diagnosis.findings
        ],
        "verdict": str(diagnosis.verdict),
        "explained": diagnosis.explained_fraction,
        "wrong_confident": result.wrong_confident,
        "confidences": result.confidences,
        "size_error": result.size_error,
        "size_sigmas": result.size_sigmas,
        "over_floor": result.over_floor,
        "parameter_error": parameter_error(truth, diagnosis),
        "bias": bias(truth, diagnosis),
    }
    return row


def _share(hits: int, of: int) -> str:
    return f"{hits:4d}/{of:<4d} {100 * hits / of:5.1f} %" if of else "   –"


def report(rows: list[dict[str, Any]]) -> None:
    """Tables on stdout."""
    singles = [r for r in rows if r["kind"] == "catalogue"]
    print("\nConfusion (true cause by row; what was said)")
    confusion: dict[str, Counter[str]] = defaultdict(Counter)
    for r in rows:
        said = r["named"] if r["outcome"] not in ("cannot_tell", "wrong_place", "crash") else r["outcome"]
        said = "RIGHT" if r["outcome"] == "right" else said
        confusion["+".join(r["causes"]) if r["kind"] != "pair" else "pair"][said] += 1
    for cause in sorted(confusion):
        total = sum(confusion[cause].values())
        words = ", ".join(f"{k} {v}" for k, v in confusion[cause].most_common(6))
        print(f"  {cause or 'null':<24} {total:4d}: {words}")
    print("\nSingle causes of the catalogue, by size over the noise")
    for low, high in BINS:
        part = [r for r in singles if low <= r["db"] < high]
        if not part:
            continue
        count = Counter(r["outcome"] for r in part)
        print(
            f"  {low:4.0f}…{high:<4.0f} dB  right {_share(count['right'], len(part))}   "
            + ", ".join(f"{k} {v}" for k, v in count.most_common() if k != "right")
        )
    print("\nFigures of the issue")
    for words, kind, good in (
        ("null called consistent            ", "null", ("right",)),
        ("outside: unexplained or partly    ", "outside", ("right",)),
        ("pairs: both named                 ", "pair", ("right", "right_and_wrong")),
        ("wrong order declared, honest      ", "wrong_order", ("right",)),
    ):
        part = [r for r in rows if r["kind"] == kind]
        print(f"  {words}{_share(sum(r['outcome'] in good for r in part), len(part))}")
    wrong = sum(bool(r.get("wrong_confident")) for r in rows)
    print(f"  wrong with confidence ≥ 0.9       {_share(wrong, len(rows))}")
    findings = [c for r in rows for c in r.get("confidences", ())]
    for low, high in ((0.0, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.01)):
        part = [ok for c, ok in findings if low <= c < high]
        print(f"  findings at {low}–{high}: right   {_share(sum(part), len(part))}")
    errors = np.array([abs(r["size_error"]) for r in rows if r.get("size_error") is not None])
    sigmas = np.array([abs(r["size_sigmas"]) for r in rows if r.get("size_sigmas") is not None])
    if errors.size:
        print(
            f"  main parameter: median error {100 * np.median(errors):.2g} %, within 10 % "
            f"{_share(int((errors < 0.1).sum()), errors.size)}, within ±3 std "
            f"{_share(int((sigmas < 3).sum()), sigmas.size)}"
        )
    floors = np.array([r["over_floor"] for r in singles if r["outcome"] == "right" and r.get("over_floor")])
    if floors.size:
        print(
            f"  residual after / floor: median {np.median(floors):.2f}, ≤ 1.2 in "
            f"{_share(int((floors <= 1.2).sum()), floors.size)}"
        )
    physical = np.array([r["parameter_error"] for r in singles if r.get("parameter_error") is not None])
    if physical.size:
        print(
            f"  worst mass or spring of the extended model: median error {100 * np.median(physical):.2g} %, "
            f"90th percentile {100 * np.quantile(physical, 0.9):.2g} %"
        )
    pairs = [r["bias"] for r in rows if r.get("bias") and r["outcome"] == "right"]
    if pairs:
        times = np.array([before / max(after, 1e-300) for before, after in pairs])
        print(
            f"  masses and springs that the effect had biased: rms error {np.median(times):.3g} times less "
            f"(median), 5 times and more {_share(int((times >= 5.0).sum()), times.size)}"
        )
    for motors in (1, 2, 3):
        part = [r["seconds"] for r in rows if len(r["masses"]) == motors]
        if part:
            print(f"  seconds a diagnosis, M={motors}: median {np.median(part):.2f}, worst {max(part):.2f}")
    failed = [r for r in rows if r["outcome"] != "right"]
    print(f"\nNot right ({len(failed)}):")
    for r in sorted(failed, key=lambda r: (r["outcome"], -r["db"])):
        print("  " + _line(r))


def _line(r: dict[str, Any]) -> str:
    """Seed, outcome, what was hidden, what was said."""
    what = "+".join(r["causes"]) or r["kind"]
    said = "; ".join(r.get("found", [])) or r["named"]
    return (
        f"seed {r['seed']:6d} {r['outcome']:<16} {r['db']:6.1f} dB {what:<24} "
        f"at {', '.join(r['places'])} → {said}"
    )


def main() -> int:
    """Run the campaign; exit status 1 where a diagnosis crashed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=300)
    parser.add_argument("--start", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--kind", choices=["catalogue", "null", "outside", "pair", "wrong_order"])
    parser.add_argument("--cause")
    parser.add_argument("--db", type=float, nargs=2)
    parser.add_argument("--motors", type=int)
    parser.add_argument("--excitation", choices=["chirp", "noise", "stepped"])
    parser.add_argument("--json", type=Path, help="rows as JSON lines, written as they come")
    arguments = parser.parse_args()
    options = {k: getattr(arguments, k) for k in ("kind", "cause", "db", "motors", "excitation")}
    jobs = [(seed, options) for seed in range(arguments.start, arguments.start + arguments.trials)]
    started = time.perf_counter()
    rows: list[dict[str, Any]] = []
    if arguments.json:
        arguments.json.unlink(missing_ok=True)

    def keep(row: dict[str, Any]) -> None:
        rows.append(row)
        print(f"{len(rows)}/{len(jobs)} {_line(row)} {row['seconds']:.1f} s", file=sys.stderr, flush=True)
        if arguments.json:
            with arguments.json.open("a") as file:
                file.write(json.dumps(row, ensure_ascii=False, default=float) + "\n")

    with get_context("spawn").Pool(arguments.jobs) as pool:
        for row in pool.imap_unordered(trial, jobs):
            keep(row)
    rows.sort(key=lambda r: r["seed"])
    report(rows)
    print(f"\n{len(rows)} trials in {time.perf_counter() - started:.0f} s")
    return int(any(r["outcome"] == "crash" for r in rows))


if __name__ == "__main__":
    sys.exit(main())
