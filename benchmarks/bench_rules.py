"""The price of each special rule of the search: what it changed, for better or worse, and what it took.

    python benchmarks/bench_rules.py [--hidden 100] [--foreign 40] [--cells 0] [--aperiodic 0] [--start SEED]
                                     [--keep NAME …] [--budget 60] [--jobs 1] [--json ROWS.jsonl]
    python benchmarks/bench_rules.py --report ROWS.jsonl …

Each case runs once with all rules. Where any fired, it runs again with all of them off but those to --keep
(rules cover for each other, so one at a time would show too little); where that does better or worse, once
more without each that fired. Columns: cases in which it was asked; *fired*: changed what was handed on;
*changed* the verdict, a cause or a place of the diagnosis; made it *better* or *worse* (by the truth: right,
contested, unexplained, missed, wrong place, wrong; in a whole cell by the number of right names less twice
that of wrong ones); *sure and wrong* (confidence of 0.9 and more) that it avoided and made; processor time of
the rule itself in all cases; its lines. The budget is one of processor time. --json goes on where it was
broken off.
"""

from __future__ import annotations

import argparse
import inspect
import json
import os
import sys
import time
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

from benchmarks.shared.campaign import each

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

ORDER = ("right", "cannot_tell", "one_of_two", "unexplained", "missed", "wrong_place", "wrong", "false_alarm")
"""Outcomes of ``hidden.scoring``, best first; a crash is worst."""

COUNTS = {"hidden": 100, "foreign": 40, "cells": 0, "aperiodic": 0}
"""How many cases of each generator are drawn."""


def case(job: tuple[str, int, dict[str, Any]]) -> dict[str, Any]:
    """One recording diagnosed with all rules, without all that fired, and where it matters without each."""
    from invid.diagnosis.rules.catalogue import BY_NAME

    kind, seed, options = job
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # or helpers take time that nobody counts
    drawn, budget, keep = drawn_case(kind, seed), options["budget"], set(options["keep"])
    row: dict[str, Any] = {"kind": kind, "seed": seed, "causes": [e.cause for e in hidden_in(drawn[1])]}
    row["all"] = diagnosed(*drawn, [], budget)
    fired = {a["rule"] for a in row["all"]["asked"] if a["changed"]} - keep
    row["without"] = {}
    if fired:
        row["together"] = diagnosed(*drawn, sorted(set(BY_NAME) - keep), budget)
        if (rank(row["together"]), row["together"]["wrong"]) != (rank(row["all"]), row["all"]["wrong"]):
            row["without"] = {name: diagnosed(*drawn, [name], budget) for name in sorted(fired)}
    return row


def drawn_case(kind: str, seed: int) -> tuple[Any, Any]:
    """The recording and its truth."""
    from hidden import aperiodic, cells, foreign, generator

    make = {
        "hidden": generator.make_case,
        "foreign": foreign.make_foreign,
        "cells": cells.draw,
        "aperiodic": aperiodic.draw,
    }
    drawn: tuple[Any, Any] = make[kind](seed)
    return drawn


def hidden_in(truth: Any) -> Any:
    """What was hidden beside friction."""
    return getattr(truth, "effects", getattr(truth, "faults", ()))


def judged(truth: Any, found: Any) -> tuple[str, bool, int]:
    """Outcome, whether something is wrong with confidence, and points (0 but for whole cells)."""
    from hidden.aperiodic import Truth as Aperiodic
    from hidden.cells import Cell, scored
    from hidden.scoring import score

    if isinstance(truth, Cell):
        told = scored(truth, found)
        right = sum(f[4] for f in told["faults"]) + told["friction"][0] + told["gravity"][0]
        return "cell", bool(told["sure_and_wrong"]), right - 2 * len(told["wrong"])
    if isinstance(truth, Aperiodic):
        rubs = any(f.effect.cause.endswith("friction") for f in found.findings)
        wrong = [f for f in found.findings if not f.effect.cause.endswith("friction")]
        outcome = "wrong" if wrong else "right" if rubs else "unexplained"
        return outcome, any(f.confidence >= 0.9 for f in wrong), 0
    result = score(truth, found)
    return result.outcome, result.wrong_confident, 0


def diagnosed(recording: Any, truth: Any, without: list[str], seconds: float) -> dict[str, Any]:
    """Outcome, answer and time of one diagnosis with some rules off."""
    from invid.diagnosis.context import context_without, use_context
    from invid.diagnosis.diagnose import diagnose
    from invid.errors import InvidError
    from invid.numerics.budget import Budget, use_budget

    context = context_without(without, clock=time.process_time)
    asked: list[dict[str, Any]] = []
    begin = time.process_time()
    floors: list[float] = []
    points, outcome, wrong, answer = 0, "crash", False, ["", []]
    try:
        with use_context(context), use_budget(Budget(seconds, time.process_time)):
            found = diagnose(recording)
        asked = [a.to_json() for a in context.latest.asked] if context.latest is not None else []
        outcome, wrong, points = judged(truth, found)
        answer = [str(found.verdict), sorted(named(f) for f in found.findings)]
        floors = [round(r.after / r.noise_floor, 3) for r in found.residual if r.noise_floor > 0]
    except InvidError as error:
        answer = [type(error).__name__, []]
    return {
        "outcome": outcome,
        "points": points,
        "wrong": wrong,
        "answer": answer,
        "floors": floors,
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
    for row in rows:
        for name in {a["rule"] for a in row["all"]["asked"]}:
            asked[name] += 1
        for name in {a["rule"] for a in row["all"]["asked"] if a["changed"]}:
            fired[name] += 1
        for a in row["all"]["asked"]:
            cpu[a["rule"]] += a.get("cpu_s") or 0.0
        for name, off in row["without"].items():
            on, count = row["all"], counts[name]
            count["changed"] += on["answer"] != off["answer"]
            count["better"] += rank(on) < rank(off)
            count["worse"] += rank(on) > rank(off)
            count["avoided"] += off["wrong"] and not on["wrong"]
            count["made"] += on["wrong"] and not off["wrong"]
    total = sum(row["all"]["cpu"] for row in rows)
    pairs = [(row["all"], row["together"]) for row in rows if "together" in row]
    print(f"{len(rows)} cases, {total:.0f} s of processor time with all rules; rules fired in {len(pairs)}")
    for told, k in (("with all rules", 0), ("without those not kept", 1)):
        spent, wrong = sum(p[k]["cpu"] for p in pairs), sum(p[k]["wrong"] for p in pairs)
        better = sum(rank(p[k]) < rank(p[1 - k]) for p in pairs)
        print(f"there, {told}: {spent:.0f} s, {better} better, {wrong} sure and wrong")
    print(f"there, another answer: {sum(a['answer'] != b['answer'] for a, b in pairs)}")
    head = ("rule", "asked", "fired", "changed", "better", "worse", "sure+wrong avoided", "made", "own s",
            "lines")  # fmt: skip
    print("| " + " | ".join(head) + " |")
    print("| --- |" + " ---: |" * (len(head) - 1))
    for rule in RULES:
        n, c = rule.name, counts[rule.name]
        cells = [asked[n], fired[n], *(c[k] for k in ("changed", "better", "worse", "avoided", "made"))]
        print(f"| {n} | {' | '.join(map(str, cells))} | {cpu[n]:.1f} | {lines[n]} |")
    for row in rows:
        together = {"all but those kept": row["together"]} if "together" in row else {}
        for name, off in (together | row["without"]).items():
            if rank(row["all"]) != rank(off) or row["all"]["wrong"] != off["wrong"]:
                on, hidden = row["all"], "+".join(row["causes"]) or "nothing"
                print(
                    f"{row['kind']} {row['seed']} {hidden}: with {name} {on['outcome']} {on['answer']}, "
                    f"without {off['outcome']} {off['answer']}"
                )


def rank(one: dict[str, Any]) -> int:
    """Place of an outcome, best first."""
    if one["outcome"] == "cell":
        return -int(one["points"])
    return ORDER.index(one["outcome"]) if one["outcome"] in ORDER else len(ORDER)


def main() -> int:
    """Run the campaign, or print the table of rows written before."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for kind, number in COUNTS.items():
        parser.add_argument(f"--{kind}", type=int, default=number, help=f"cases of tests/hidden: {kind}")
    parser.add_argument("--start", type=int, default=910_000)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--keep", nargs="+", default=[], help="rules that stay on")
    parser.add_argument("--budget", type=float, default=60.0, help="processor seconds of a diagnosis")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--report", type=Path, nargs="+")
    arguments = parser.parse_args()
    if arguments.report:
        report([json.loads(x) for p in arguments.report for x in p.read_text(encoding="utf-8").splitlines()])
        return 0
    options = {"keep": arguments.keep, "budget": arguments.budget}
    counts = {kind: getattr(arguments, kind) for kind in COUNTS}
    order = [(k / n, kind, k) for kind, n in counts.items() for k in range(n)]  # evenly mixed
    jobs = [(kind, arguments.start + k, options) for _, kind, k in sorted(order)]
    rows: list[dict[str, Any]] = []
    if arguments.json and arguments.json.exists():
        rows = [json.loads(x) for x in arguments.json.read_text(encoding="utf-8").splitlines()]
    done = {(r["kind"], r["seed"]) for r in rows}
    jobs = [j for j in jobs if j[:2] not in done]

    def keep(row: dict[str, Any]) -> None:
        rows.append(row)
        off = sum(r["answer"] != row["all"]["answer"] for r in row["without"].values())
        other = row["together"]["outcome"] if "together" in row else "none fired"
        print(
            f"{len(rows)} {row['kind']} {row['seed']}: {row['all']['outcome']}, without {other}; "
            f"{len(row['without'])} rules tried, {off} matter; {row['all']['cpu']:.1f} s",
            file=sys.stderr,
            flush=True,
        )
        if arguments.json:
            with arguments.json.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row, ensure_ascii=False, default=float) + "\n")

    each(jobs, case, keep, arguments.jobs)
    report(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
