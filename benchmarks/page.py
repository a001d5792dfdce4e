"""One page of figures from the benchmarks' own summaries: what each prints, under the command that makes it.

python benchmarks/run_all.py --page docs/reference/benchmarks.md [--quick]
"""

from __future__ import annotations

import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
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
    most_lines: int = 60


SECTIONS = (
    Section(
        "Accuracy against the Cramér-Rao bound",
        "The bound is the smallest standard deviation that any unbiased estimator can have on these records. "
        "`white` is the case study of the paper with three axes; the plants are simulated by code that the "
        "identification does not use. z is error over stated deviation.",
        "identification/bench_identify.py",
        ("--draws", "100"),
        ("--draws", "10"),
    ),
    Section(
        "Robot time",
        "The case study through the simulated cell with friction, quantisation and noise: plans from nothing "
        "and from a model. Stepped sine has half the torque, and limits of travel and speed lifted.",
        "planning/bench_plan.py",
        ("--seeds", "2"),
        ("--seeds", "1"),
    ),
    Section(
        "Hidden causes: what was hidden, what was said",
        "The generator hides one cause of the catalogue (or none, a pair, one outside the catalogue, a "
        "wrong number of masses) in a plant of its own; the diagnosis gets the recording alone. Trial n has "
        "the seed start + n; `make_case(seed)` in `tests/hidden` makes it again. Sizes are in decibels over "
        "the noise; −10 dB is still significant, because there are hundreds of lines.",
        "bench_hidden.py",
        ("--trials", "300", "--start", "2500000", "--jobs", "1"),
        ("--trials", "60", "--start", "2500000", "--jobs", "1"),
        90,
    ),
    Section(
        "Beside other ways of fitting, on the same records",
        "Case study without friction, everybody gets the same spectra, the torque when it acts, and the "
        "number of masses. Errors are medians over the seeds; processor time is of one core.",
        "identification/bench_peer_models.py",
        ("--seeds", "5", "--seed0", "300"),
        ("--seeds", "2", "--seed0", "300"),
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


@dataclass(frozen=True)
class Ran:
    """What a benchmark printed, its exit status, and the processor seconds that it took."""

    printed: str
    status: int
    cpu_s: float


def run(command: Sequence[str]) -> Ran:
    """The command in a process of its own; progress goes to this process' stderr."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, *command], cwd=HERE.parent, stdout=subprocess.PIPE, text=True, check=False
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Ran(done.stdout, done.returncode, cpu)


def page(*, quick: bool, runner: Callable[[Sequence[str]], Ran] = run) -> tuple[str, int]:
    """The page as Markdown, and how many benchmarks ended with a bar missed or an error."""
    mode = " --quick" if quick else ""
    parts = [
        "# Benchmarks",
        f"Made by `python benchmarks/run_all.py --page docs/reference/benchmarks.md{mode}`: what each "
        "benchmark prints, under the command that prints it. Nothing here is written by hand. How to read "
        "the figures of hidden causes: [how it is tested](../explanations/diagnosis.md#how-it-is-tested).",
        machine(),
    ]
    if quick:
        parts.append("Short settings: few seeds. Without `--quick` the same commands run in full, for hours.")
    missed = 0
    for section in SECTIONS:
        arguments = section.quick if quick else section.full
        command = (f"benchmarks/{section.script}", *arguments)
        ran = runner(command)
        missed += ran.status != 0
        ended = "" if ran.status == 0 else f"; exit status {ran.status}: a bar is missed, or it failed"
        shown = " ".join(f'"{word}"' if " " in word else word for word in command)
        parts += [
            f"## {section.title}",
            section.words,
            f"`python {shown}` ({ran.cpu_s:.0f} s of processor time{ended})",
            f"```text\n{shortened(ran.printed, section.most_lines)}\n```",
        ]
    return "\n\n".join(parts) + "\n", missed


def machine() -> str:
    """Where and when the figures were made."""
    root = HERE.parent
    revision = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=root, capture_output=True, text=True, check=False
    ).stdout.strip()
    return (
        f"Revision {revision or 'unknown'}, {time.strftime('%Y-%m-%d', time.gmtime())}; {processor()}, "
        f"{os.cpu_count()} logical cores, load {os.getloadavg()[0]:.1f} at the start; Python "
        f"{platform.python_version()}, {platform.system()}."
    )


def processor() -> str:
    """The processor's name as the kernel knows it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def shortened(printed: str, most: int) -> str:
    """Without lines at the end that nobody reads: ``most`` lines, the last says how many are left out."""
    lines = [line.rstrip()[:200] for line in printed.strip("\n").splitlines()]
    if len(lines) <= most:
        return "\n".join(lines)
    return "\n".join([*lines[:most], f"… ({len(lines) - most} lines more)"])
