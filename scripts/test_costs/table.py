"""Print what tests cost and what they alone run, and choose which ones `make test` can do without.

    TEST_COSTS=build/costs python -m pytest -p scripts.test_costs.plugin -n 2 --dist loadgroup   # once
    python -m scripts.test_costs.table build/costs                 # each line of tests/campaign.csv
    python -m scripts.test_costs.table build/costs --dearest 60    # any test, and what it alone runs
    python -m scripts.test_costs.table build/costs --choose 500    # what to move, until so much is left
    python -m scripts.test_costs.table build/costs --write         # the figures into tests/campaign.csv

"Alone" are blocks (branches of the code) that none of the tests which stay runs. A module's fixture counts
for all tests of its file.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from scripts.test_costs.blocks import ROOT, product_lines

CAMPAIGN = ROOT / "tests" / "campaign.csv"
CHEAP_S = 0.7
"""Processor time up to which a test stays whatever it runs: what it asserts is worth that."""


@dataclass
class Test:
    """One test: seconds of wall clock and processor, blocks that it runs."""

    wall: float = 0.0
    cpu: float = 0.0
    ran: set[int] = field(default_factory=set)


def measured(folder: Path) -> tuple[dict[str, Test], dict[str, set[int]]]:
    """Return what was measured of each test, the last try of it, and the blocks of each file's set-up."""
    tests: dict[str, Test] = {}
    set_up: dict[str, set[int]] = defaultdict(set)
    for path in sorted(folder.glob("costs-*.jsonl")):
        for line in path.read_text(encoding="utf-8").splitlines():
            phase = json.loads(line)
            name = phase["test"]
            if phase["phase"] == "setup":
                tests[name] = Test()
                set_up[name.partition("::")[0]].update(phase["ran"])
            test = tests.setdefault(name, Test())
            test.wall += phase["wall"]
            test.cpu += phase["cpu"]
            if phase["phase"] != "setup":
                test.ran.update(phase["ran"])
    return tests, set_up


def listed() -> list[str]:
    """Return the tests of the table: files, functions or single cases."""
    with CAMPAIGN.open(encoding="utf-8", newline="") as file:
        return [row["test"] for row in csv.DictReader(file)]


def under(entry: str, tests: Iterable[str]) -> list[str]:
    """Return the tests that an entry of the table stands for."""
    return [t for t in tests if t == entry or t.startswith((f"{entry}::", f"{entry}["))]


def ran_by(names: Iterable[str], tests: dict[str, Test], set_up: dict[str, set[int]]) -> set[int]:
    """Return the blocks that these tests and the fixtures of their files run."""
    blocks: set[int] = set()
    for name in names:
        blocks |= tests[name].ran | set_up[name.partition("::")[0]]
    return blocks


def places(blocks: set[int]) -> str:
    """Say where blocks are: the files with most of them."""
    starts = sorted((first, path) for path, first in product_lines().items() if path)
    count: dict[str, int] = defaultdict(int)
    for block in blocks:
        count[max((s for s in starts if s[0] <= block), default=(0, "?"))[1]] += 1
    most = sorted(count.items(), key=lambda c: -c[1])[:3]
    return ", ".join(f"{Path(path).name} {n}" for path, n in most)


def choose(tests: dict[str, Test], moved: set[str], seconds: float) -> set[str]:
    """Return what to move beside ``moved`` until the tests that stay cost so much processor time.

    The dearest first; what alone runs more blocks than it costs seconds stays, and one test of each file.
    """
    stay = {name: t for name, t in tests.items() if name not in moved}
    runs = Counter(block for t in stay.values() for block in t.ran)
    left = Counter(name.partition("::")[0] for name in stay)
    total, found = sum(t.cpu for t in stay.values()), set[str]()
    for name in sorted(stay, key=lambda n: -stay[n].cpu):
        test, file = stay[name], name.partition("::")[0]
        alone = sum(runs[block] == 1 for block in test.ran)
        if total <= seconds or test.cpu < CHEAP_S:
            break
        if left[file] == 1 or alone > test.cpu:
            continue
        found.add(name)
        total -= test.cpu
        left[file] -= 1
        runs.subtract(test.ran)
    return found


def entries_for(moved: set[str], tests: Iterable[str]) -> list[str]:
    """Return the fewest entries of the table for these tests: whole functions where all their cases go."""
    cases: dict[str, set[str]] = defaultdict(set)
    for name in tests:
        cases[name.partition("[")[0]].add(name)
    whole = {function for function, all_ in cases.items() if all_ <= moved}
    return sorted({n.partition("[")[0] if n.partition("[")[0] in whole else n for n in moved})


def main(arguments: list[str]) -> None:
    """Print the table asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="+")
    parser.add_argument("--dearest", type=int, default=0)
    parser.add_argument("--choose", type=float, default=0.0)
    parser.add_argument("--write", action="store_true")
    chosen = parser.parse_args(arguments)
    tests: dict[str, Test] = {}
    set_up: dict[str, set[int]] = defaultdict(set)
    for folder in chosen.folder:
        some, theirs = measured(folder)
        tests.update(some)
        for name, blocks in theirs.items():
            set_up[name] |= blocks
    entries = listed()
    moved = {t for e in entries for t in under(e, tests)}
    if chosen.choose:
        unknown = [e for e in entries if not under(e, tests)]
        moved |= choose(tests, moved, chosen.choose)
        entries = [*unknown, *entries_for(moved, tests)]
    stay = ran_by(tests.keys() - moved, tests, set_up)
    total, gone = sum(t.cpu for t in tests.values()), sum(tests[t].cpu for t in moved)
    lost = ran_by(moved, tests, set_up) - stay
    print(f"{len(tests)} tests, {total:.0f} s of processor; moved {len(moved)}, {gone:.0f} s")
    print(f"blocks that the rest runs {len(stay)}, that the moved ones alone run {len(lost)}: {places(lost)}")
    if chosen.dearest:
        for name in sorted(tests, key=lambda t: -tests[t].cpu)[: chosen.dearest]:
            others = ran_by(tests.keys() - {name}, tests, set_up)
            alone = tests[name].ran - others
            mark = "moved" if name in moved else ""
            print(f"{tests[name].cpu:7.1f} s {tests[name].wall:7.1f} s {len(alone):4d} {mark:6s}{name}")
        return
    rows = []
    for entry in entries:
        names = under(entry, tests)
        alone = ran_by(names, tests, set_up) - ran_by(tests.keys() - moved, tests, set_up)
        seconds = f"{sum(tests[n].cpu for n in names):.1f}" if names else ""
        told = str(len(alone)) if names else ""
        rows.append({"processor_s": seconds, "blocks_alone": told, "test": entry})
    for row in rows:
        print(f"{row['processor_s']:>8} s {row['blocks_alone']:>5}  {row['test']}")
    if chosen.write:
        with CAMPAIGN.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main(sys.argv[1:])
