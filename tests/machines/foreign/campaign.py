"""One run of a kind: drawn, run, judged."""

import shutil
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np

from .cell import Cell, Run
from .draft import ALWAYS, Draft, Timeline, draw_cell, read_timeline
from .judge import Verdict, judge_all
from .kinds import KINDS

ORDINARY = "ordinary"
"""The kind to which nothing happens."""
UNKNOWN = Timeline({}, [], [], None)


@dataclass(frozen=True)
class Outcome:
    """A run, and what is said of it."""

    draft: Draft
    verdict: Verdict
    run: Run | None


class Campaign:
    """Runs; how an ordinary run of each machine goes is found out once."""

    def __init__(self, keep: Path | None = None) -> None:
        self._known: dict[object, Timeline] = {}
        self._keep = keep

    def run(self, kind: str, phase: str, loads: int, seed: int) -> Outcome:
        """One of them."""
        what = KINDS[kind]
        d = draw_cell(kind, phase, loads, seed, brakes=what.brakes)
        timeline = UNKNOWN if phase == ALWAYS else self.timeline(d)
        some = [a for a in d.axes if a.load] or d.axes
        d.victims = list(some) if d.rng.random() < 0.6 else [d.rng.choice(some)]
        if phase == ALWAYS:
            d.victims = list(d.axes)
        else:
            at = timeline.draw(phase, d.axes.index(d.victims[0]), d.rng)
            if at is None:
                missed = Verdict(
                    (), False, False, f"the ordinary run (exit {timeline.status}) has no {phase}", None
                )
                return Outcome(d, missed, None)
            d.at = at
        d.healthy = what.healthy
        what.make(d)
        runs = self._commands(d)
        return Outcome(d, judge_all(d, runs, timeline), runs[-1])

    def _commands(self, d: Draft) -> list[Run]:
        name = f"{d.kind}-{d.phase}-{d.loads}-{d.seed}-".replace(" ", "_")
        folder = Path(tempfile.mkdtemp(prefix=name, dir=self._keep))
        try:
            cell = Cell(folder, d.spec(), d.config())
            runs = [cell.command(name, events=events) for name, events in [("measure", d.events), *d.later]]
            if d.kind == ORDINARY:
                recorded = recorded_in(cell.recording, runs[0], len(d.axes))
                self._known[d.cell_key] = read_timeline(runs[0], len(d.axes), recorded)
            return runs
        finally:
            if self._keep is None:
                shutil.rmtree(folder, ignore_errors=True)

    def timeline(self, d: Draft) -> Timeline:
        """How an ordinary run of this machine goes."""
        if d.cell_key not in self._known:
            self._commands(replace(d, kind=ORDINARY))
        return self._known[d.cell_key]


def recorded_in(path: Path, run: Run, axes: int) -> list[tuple[float, float]]:
    """When each experiment of a recording was, by the motion that is in it."""
    if not path.exists() or not len(run.trace):
        return []
    true = np.stack([run.of(k)["q"] for k in range(axes)], axis=1).astype(float)
    t = run.of(0)["t"]
    spans = []
    with h5py.File(path) as f:
        for group in f.get("experiments", {}).values():
            seen = group["position"][:]
            if len(seen) < 50 or len(seen) > len(true):
                continue
            coarse = np.arange(0, len(seen), max(len(seen) // 60, 1))
            starts = np.arange(len(true) - len(seen) + 1)
            misfit = sum(((true[starts + c] - seen[c]) ** 2).sum(axis=1) for c in coarse)
            i = int(np.argmin(misfit))
            spans.append((float(t[i]), float(t[i + len(seen) - 1])))
    return sorted(spans)
