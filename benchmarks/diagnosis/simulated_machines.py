"""Machines drawn at random, integrated by code of their own: how often what is named is right."""

from __future__ import annotations

import contextlib
import io
import json
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from invid.cli.app import run

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

START = 10_000
"""First seed: those below were looked at while the diagnosis was changed."""


def campaign(draws: int, start: int = START) -> int:
    """Print one line for each machine and the table of rates; 1 where anything failed or was wrongly sure."""
    rates: dict[str, Counter[str]] = defaultdict(Counter)
    errors: dict[str, list[float]] = defaultdict(list)
    for seed in range(start, start + draws):
        family, outcome, line, found = one(seed)
        rates[family][outcome] += 1
        for name, error in found.items():
            errors[name.split("@")[0] + " " + name.split(".")[-1]].append(error)
        print(f"{seed} {family}: {outcome}; {line}", flush=True)
    columns = ("all named", "some missed", "unsure and wrong", "sure and wrong", "refused", "failed")
    print("\n| machine | draws | " + " | ".join(columns) + " |\n|" + " --- |" * (len(columns) + 2))
    for family, count in sorted(rates.items()):
        cells = " | ".join(str(count[c]) for c in columns)
        print(f"| {family} | {sum(count.values())} | {cells} |")
    print("\n| parameter | named | median error [%] | 90 % below [%] |\n| --- | --- | --- | --- |")
    for name, values in sorted(errors.items()):
        middle, most = 100 * np.quantile(values, [0.5, 0.9])
        print(f"| {name} | {len(values)} | {middle:.2g} | {most:.2g} |")
    return int(any(c["failed"] + c["sure and wrong"] for c in rates.values()))


def one(seed: int) -> tuple[str, str, str, dict[str, float]]:
    """Family, outcome, a line of detail and relative parameter errors of one machine."""
    from machines.draw import draw
    from machines.score import score
    from machines.write import write

    machine = draw(seed)
    more = ["--masses", "2"] if machine.family == "flexible" else []
    said = io.StringIO()
    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stderr(said):
        folder = Path(name)
        source, chart = write(machine, folder, seed)
        record, out = folder / "r.h5", folder / "d.json"
        with contextlib.redirect_stdout(io.StringIO()):
            statuses = [run(["import", str(source), "--map", str(chart), "-o", str(record)])]
            statuses += [
                run(["identify", str(record), *more]),
                run(["diagnose", str(record), "-o", str(out), *more]),
            ]
        if not out.exists():
            outcome = "refused" if set(statuses) <= {0, 2, 3} else "failed"
            return machine.family, outcome, said.getvalue().strip()[-160:], {}
        diagnosis = json.loads(out.read_text(encoding="utf-8"))
    judged = score(machine, diagnosis)
    outcome = "all named"
    if judged.wrong_sure:
        outcome = "sure and wrong"
    elif judged.wrong:
        outcome = "unsure and wrong"
    elif judged.missed:
        outcome = "some missed"
    line = f"{machine.scenario}; {diagnosis['verdict']}"
    for word, causes in (("missed", judged.missed), ("wrong", [*judged.wrong_sure, *judged.wrong])):
        line += f"; {word} {', '.join(causes)}" if causes else ""
    return machine.family, outcome, line, judged.errors
