"""The frozen cases: which there are, and how each one's recording is made (once, into the cache)."""

from __future__ import annotations

import contextlib
import io
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count, islice
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

START = 870_000
"""First seed of the drawn cases; no campaign of the docs used those from here on."""


@dataclass(frozen=True)
class Case:
    """One recording: its name, its kind with seed or title, and further arguments of the commands."""

    name: str
    kind: str
    seed: int = 0
    motors: int | None = None
    title: str = ""


def cases(number: int, motors: int | None) -> list[Case]:
    """The first ``number`` cases; drawn ones with at most ``motors`` motors where that is given.

    The demo and the real records come first, where at least a hundred are asked for; then the generators
    in turn, so that a short list is a sample of the long one.
    """
    fixed = [Case("demo", "demo"), *_real_records()] if number >= 100 and motors is None else []
    return [*fixed, *islice(_drawn(motors), max(0, number - len(fixed)))]


def _drawn(motors: int | None) -> Iterator[Case]:
    for seed in count(START):
        drawn = None if motors is None else 1 + seed % motors
        yield Case(f"hidden{'' if drawn is None else f'-{drawn}m'}-{seed}", "hidden", seed, drawn)


def _real_records() -> list[Case]:
    from benchmarks.diagnosis.bench_real_data import DATA, RECORDS

    found = [(title, source) for title, source, _ in RECORDS if (DATA / source).exists()]
    return [Case("real-" + "".join(c if c.isalnum() else "_" for c in t), "real", title=t) for t, _ in found]


def make(case: Case, place: Path) -> None:
    """Write the recording of a case to ``place``; there is none where that fails."""
    makers: dict[str, Callable[[Case, Path], None]] = {
        "hidden": _drawn_recording, "real": _real, "demo": _demo,
    }  # fmt: skip
    with tempfile.TemporaryDirectory(dir=place.parent) as name:
        written = Path(name) / "recording.h5"
        makers[case.kind](case, written)
        os.replace(written, place)


def _drawn_recording(case: Case, place: Path) -> None:
    from hidden.generator import make_case

    from invid.recording import write_recording

    recording, _ = make_case(case.seed, motors=case.motors)
    write_recording(recording, place)


def _real(case: Case, place: Path) -> None:
    from benchmarks.diagnosis.bench_real_data import DATA, RECORDS

    (source, chart), *_ = [(s, c) for t, s, c in RECORDS if t == case.title]
    chart_file = ROOT / "configs" / "import" / f"{chart}.yaml"
    command("import", str(DATA / source), "--map", str(chart_file), "-o", str(place))


def _demo(case: Case, place: Path) -> None:
    command("demo", "--out", str(place.parent / "demo"))
    shutil.copy(place.parent / "demo" / "recording.h5", place)


def command(*arguments: str, fine: tuple[int, ...] = (0,)) -> None:
    """Run a command of invid in this process; what it says only where it ends with another status."""
    from invid.cli.app import run

    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        status = run(list(arguments))
    if status not in fine:
        raise RuntimeError(f"invid {' '.join(arguments)} ended with {status}: {said.getvalue().strip()}")
