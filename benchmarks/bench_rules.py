"""The price of each special rule of the search: what it changed, for better or worse, and what it took.

    python benchmarks/bench_rules.py [--trials 100] [--foreign 40] [--start SEED] [--motors K] [--jobs 1]
                                     [--json ROWS.jsonl] [--rules NAME …]
    python benchmarks/bench_rules.py --report ROWS.jsonl …

Each case runs once with all rules. Then each rule is switched off in the cases that it changed anything in,
for elsewhere it cannot matter. Columns: cases in which it was asked; *fired*: changed what was handed on;
*changed* the verdict, a cause or a place of the diagnosis; made it *better* or *worse* (by the truth: right,
contested, unexplained, missed, wrong place, wrong); *sure and wrong* (confidence of 0.9 and more) that it
avoided and made; processor time of the rule itself in all cases, the diagnoses' with it less without it where
it fired; its lines. --json goes on where it was broken off.
"""

from __future__ import annotations

import argparse
import inspect
import json
import multiprocessing
import os
import sys
import time
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

ORDER = ("right", "cannot_tell", "one_of_two", "unexplained", "missed", "wrong_place", "wrong", "false_alarm")
"""Outcomes of ``hidden.scoring``, best first; a crash is worst."""


def case(job: tuple[str, int, dict[str, Any]]) -> dict[str, Any]:
    """One recording diagnosed with all rules, then without each that fired."""
    from hidden.foreign import make_foreign
    from hidden.generator import make_case

    kind, seed, options = job
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # or helpers take time that nobody counts
    if kind == "foreign":
        recording, truth = make_foreign(seed, motors=options["motors"])
    else:
        recording, truth = make_case(seed, motors=options["motors"])
    row: dict[str, Any] = {"kind": kind, "seed": seed, "causes": [e.cause for e in truth.effects]}
    row["all"] = diagnosed(recording, truth, [])
    fired = {a["rule"] for a in row["all"]["asked"] if a["changed"]}
    wanted = options["rules"]
    row["without"] = {
        name: diagnosed(recording, truth, [name]) for name in sorted(fired) if not wanted or name in wanted
    }
    return row


def diagnosed(recording: Any, truth: Any, without: list[str]) -> dict[str, Any]:
    """Outcome, answer and time of one diagnosis with some rules off."""
    from hidden.scoring import score

    from invid.diagnosis.context import running, without_rules
    from invid.diagnosis.diagnose import diagnose
    from invid.errors import InvidError

    context = without_rules(without, clock=time.process_time)
    asked: list[dict[str, Any]] = []
    begin = time.process_time()
    try:
        with running(context):
            found = diagnose(recording)
        asked = [a.to_json() for a in context.latest.asked] if context.latest is not None else []
        result = score(truth, found)
        outcome, wrong = result.outcome, result.wrong_confident
        answer = [str(found.verdict), sorted(named(f) for f in found.findings)]
    except InvidError as error:
        outcome, wrong, answer = "crash", False, [type(error).__name__, []]
    return {
        "outcome": outcome,
        "wrong": wrong,
        "answer": answer,
        "cpu": time.process_time() - begin,
        "asked": asked,
    }


def named(finding: Any) -> str:
    """Cause and place of a finding."""
    e = finding.effect
    return " ".join(x for x in (e.cause, e.axis, e.element, e.other_axis) if x)


def lines_of() -> dict[str, int]:
    """Lines of each rule: of its module, shared evenly among the rules that are in it."""
    from invid.diagnosis.rules.catalogue import RULES

    home = {r.name: inspect.getsourcefile(inspect.unwrap(r.apply)) or "" for r in RULES}
    home = {name: path for name, path in home.items() if "/rules/" in path and "catalogue" not in path}
    home["friction-ladder"] = str(ROOT / "invid/diagnosis/rules/near_variants.py")
    shared = Counter(home.values())
    size = {path: len(Path(path).read_text(encoding="utf-8").splitlines()) for path in shared}
    functions = {r.name: len(inspect.getsourcelines(r.apply)[0]) for r in RULES if r.name not in home}
    return functions | {name: round(size[path] / shared[path]) for name, path in home.items()}


def report(rows: list[dict[str, Any]]) -> None:
    """The table, the dearest rules that changed least first."""
    from invid.diagnosis.rules.catalogue import RULES

    lines = lines_of()
    asked, fired, cpu = Counter[str](), Counter[str](), Counter[str]()
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    spent: dict[str, float] = defaultdict(float)
    for row in rows:
        for name in {a["rule"] for a in row["all"]["asked"]}:
            asked[name] += 1
        for a in row["all"]["asked"]:
            cpu[a["rule"]] += a.get("cpu_s") or 0.0
        for name, off in row["without"].items():
            on, count = row["all"], counts[name]
            fired[name] += 1
            spent[name] += on["cpu"] - off["cpu"]
            count["changed"] += on["answer"] != off["answer"]
            count["better"] += rank(on) < rank(off)
            count["worse"] += rank(on) > rank(off)
            count["avoided"] += off["wrong"] and not on["wrong"]
            count["made"] += on["wrong"] and not off["wrong"]
    total = sum(row["all"]["cpu"] for row in rows)
    print(f"{len(rows)} cases, {total:.0f} s of processor time with all rules")
    head = ("rule", "asked", "fired", "changed", "better", "worse", "sure+wrong avoided", "made", "own s",
            "diagnosis s", "lines")  # fmt: skip
    print("| " + " | ".join(head) + " |")
    print("| --- |" + " ---: |" * (len(head) - 1))
    for rule in RULES:
        n, c = rule.name, counts[rule.name]
        cells = [asked[n], fired[n], *(c[k] for k in ("changed", "better", "worse", "avoided", "made"))]
        print(f"| {n} | {' | '.join(map(str, cells))} | {cpu[n]:.1f} | {spent[n]:+.1f} | {lines[n]} |")
    for row in rows:
        for name, off in row["without"].items():
            if rank(row["all"]) != rank(off) or row["all"]["wrong"] != off["wrong"]:
                on, hidden = row["all"], "+".join(row["causes"]) or "nothing"
                print(
                    f"{row['kind']} {row['seed']} {hidden}: with {name} {on['outcome']} {on['answer']}, "
                    f"without {off['outcome']} {off['answer']}"
                )


def rank(one: dict[str, Any]) -> int:
    """Place of an outcome, best first."""
    return ORDER.index(one["outcome"]) if one["outcome"] in ORDER else len(ORDER)


def main() -> int:
    """Run the campaign, or print the table of rows written before."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--trials", type=int, default=100, help="cases of the first generator")
    parser.add_argument("--foreign", type=int, default=40, help="cases of the second")
    parser.add_argument("--start", type=int, default=910_000)
    parser.add_argument("--motors", type=int)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--rules", nargs="+", default=[], help="price these alone")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--report", type=Path, nargs="+")
    arguments = parser.parse_args()
    if arguments.report:
        report([json.loads(x) for p in arguments.report for x in p.read_text(encoding="utf-8").splitlines()])
        return 0
    options = {"motors": arguments.motors, "rules": arguments.rules}
    jobs = [("hidden", arguments.start + k, options) for k in range(arguments.trials)]
    jobs += [("foreign", arguments.start + k, options) for k in range(arguments.foreign)]
    rows: list[dict[str, Any]] = []
    if arguments.json and arguments.json.exists():
        rows = [json.loads(x) for x in arguments.json.read_text(encoding="utf-8").splitlines()]
    done = {(r["kind"], r["seed"]) for r in rows}
    jobs = [j for j in jobs if j[:2] not in done]

    def keep(row: dict[str, Any]) -> None:
        rows.append(row)
        off = sum(r["answer"] != row["all"]["answer"] for r in row["without"].values())
        print(
            f"{len(rows)} {row['kind']} {row['seed']}: {row['all']['outcome']}, {len(row['without'])} rules "
            f"fired, {off} matter, {row['all']['cpu']:.1f} s",
            file=sys.stderr,
            flush=True,
        )
        if arguments.json:
            with arguments.json.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row, ensure_ascii=False, default=float) + "\n")

    if arguments.jobs > 1:
        with multiprocessing.get_context("spawn").Pool(arguments.jobs) as pool:
            for row in pool.imap_unordered(case, jobs):
                keep(row)
    else:
        for job in jobs:
            keep(case(job))
    report(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
