"""`make bench`: every benchmark in turn, each in its own process; prints what each one prints.

    python benchmarks/run_all.py                                                   # all, whole campaigns
    python benchmarks/run_all.py --page docs/reference/benchmarks.md [--quick]     # the page of figures

A benchmark is any `bench_*.py` below `benchmarks/`; with no arguments it runs its whole campaign. The page
has what those of ``SECTIONS`` print, under the command that makes it.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Section:
    """One benchmark of the page: its words, and its command in full and in short."""

    title: str
    words: str
    script: str
    """Path below ``benchmarks/``."""
    full: tuple[str, ...]
    quick: tuple[str, ...]


SECTIONS = (
    Section(
        "Accuracy against the Cramér-Rao bound and beside other ways of fitting",
        "The bound is the smallest standard deviation that any unbiased estimator can have on these records. "
        "`white` is the paper's case study without friction, simulated by code that the identification does "
        "not use; z is error over stated deviation. In the table everybody gets the same spectra and the "
        "number of masses; errors are medians.",
        "identification/bench_identify.py",
        ("--draws", "100", "--peers", "5"),
        ("--draws", "10", "--peers", "2"),
    ),
    Section(
        "Robot time",
        "The case study through the simulated cell with friction, quantisation and noise: plans from nothing "
        "and from a model.",
        "planning/bench_plan.py",
        ("--seeds", "2"),
        ("--seeds", "1"),
    ),
    Section(
        "Hidden causes: what was hidden, what was said",
        "One cause of the catalogue (or none, a pair, one outside it, a wrong number of masses) is hidden in "
        "a plant; the diagnosis gets the recording alone. `make_case(seed)` in `tests/hidden` makes a trial "
        "again.",
        "bench_hidden.py",
        ("--trials", "300", "--start", "2500000", "--jobs", "1"),
        ("--trials", "60", "--start", "2500000", "--jobs", "1"),
    ),
    Section(
        "Import of large files",
        "200 MB of three axes beside the library that reads them: polars, python-can, asammdf.",
        "recording/bench_import.py",
        (),
        (),
    ),
    Section(
        "Processor time of a diagnosis",
        "One core, each command in a process of its own, counted after its imports; beside each figure its "
        "bar, and its ratio to a fixed workload, which says the same on a faster machine.",
        "diagnosis/bench_speed.py",
        (),
        ("plain", "dry", "demo", "rubbing", "cell", "aperiodic", "bench", "six", "eight", "help"),
    ),
)  # fmt: skip


def page(*, quick: bool) -> tuple[str, int]:
    """The page as Markdown, and how many benchmarks ended with a bar missed or an error."""
    parts = [
        "# Benchmarks",
        f"Made by `python benchmarks/run_all.py --page docs/reference/benchmarks.md{' --quick' * quick}`: "
        "what each benchmark prints, under the command that prints it. Nothing here is written by hand. "
        "How to read the figures of hidden causes: [how it is tested]"
        "(../explanations/diagnosis.md#how-it-is-tested).",
        machine(),
    ]
    if quick:
        parts.append("Short settings: few seeds. Without `--quick` the same commands run in full, for hours.")
    missed = 0
    for section in SECTIONS:
        command = (f"benchmarks/{section.script}", *(section.quick if quick else section.full))
        before = os.times()
        done = subprocess.run(
            [sys.executable, *command], cwd=HERE.parent, stdout=subprocess.PIPE, text=True, check=False
        )
        seconds = sum(os.times()[2:4]) - sum(before[2:4])
        missed += done.returncode != 0
        status = f"; exit status {done.returncode}: a bar is missed, or it failed" if done.returncode else ""
        lines = (line.rstrip()[:200] for line in done.stdout.strip("\n").splitlines())
        parts += [
            f"## {section.title}",
            section.words,
            f"`python {' '.join(command)}` ({seconds:.0f} s of processor time{status})",
            "```text\n" + "\n".join(lines) + "\n```",
        ]
    return "\n\n".join(parts) + "\n", missed


def machine() -> str:
    """Where and when the figures were made."""
    git = ["git", "rev-parse", "--short", "HEAD"]
    revision = subprocess.run(git, cwd=HERE.parent, capture_output=True, text=True, check=False).stdout
    told = Path("/proc/cpuinfo").read_text(encoding="utf-8").partition("model name")[2]
    name = told.partition("\n")[0].strip(" \t:") or platform.machine()
    return (
        f"Revision {revision.strip()}, {time.strftime('%Y-%m-%d', time.gmtime())}; "
        f"{name}, {os.cpu_count()} logical cores, load {os.getloadavg()[0]:.1f} at the start; "
        f"Python {platform.python_version()}, {platform.system()}."
    )


def main() -> int:
    """Run all; the exit status is the number of benchmarks that failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--page", type=Path, help="write the page of figures here and run nothing else")
    parser.add_argument("--quick", action="store_true", help="short settings, with --page")
    options, rest = parser.parse_known_args()
    if options.page:
        text, missed = page(quick=options.quick)
        options.page.write_text(text, encoding="utf-8")
        return missed
    failed = 0
    for script in sorted(HERE.rglob("bench_*.py")):
        print(f"\n=== {script.relative_to(HERE)}", flush=True)
        failed += subprocess.run([sys.executable, str(script), *rest], check=False).returncode != 0
    return failed


if __name__ == "__main__":
    sys.exit(main())
