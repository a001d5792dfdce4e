"""Situations crossed with phases on foreign drives in virtual time, judged on the true motion of the plant.

    python benchmarks/drivers/bench_foreign_drives.py --runs 300 --seed 7000

Every situation meets every phase and every way to carry (nothing, a load held by its drive, a load on a
brake), at a drawn moment; what is left of the runs goes round again. Wire, drives and plant:
`tests/contract/foreign_wire.py`. A violation is

- torque asked or given above the tightest limit by more than 5 %;
- travel under power of an axis without load beyond window and stated room;
- a loaded axis more than 0.02 rad from where it was, beyond what is played and the bounds of ``BY_BRAKE``;
- "held by" of an axis that moves, or no word of one that is not held;
- a foreign node that is written to, commanded or changed;
- a healthy cell that is not measured.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
import threading
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "contract")]

from foreign_wire import LIMIT, LOAD, RATED, WINDOW, ForeignCell, ForeignDrive, Habits, Run  # noqa: E402

PHASES = {
    "enabling": ("enabling", "settling"),
    "at rest": ("settling", "trying the signs of A1"),
    "trial": ("trying the signs of A1", "trying the signs of A2"),
    "hold": ("trying the signs of A2", "trying the amplitude"),
    "amplitude": ("trying the amplitude", "experiment 1 of 2"),
    "run": ("experiment 1 of 2", "coming to rest"),
    "leaving": ("stop", "closed"),
}
"""From where to where in a run to which nothing happens; leaving: also after a stop in the run."""
HELD, PLAYED, ROOM = 0.02, 0.03, 0.5
"""A loaded axis may be so far from where it was in one event; what is played; beyond the window [rad]."""
LEAVING_S = 0.6
"""After a stop by a person: on the way out until then."""
SEEN_S = 0.1
"""What begins so shortly before the end is not seen (how soon a fall is seen: the same page)."""
FOREIGN = 3
"""A node on the bus that is not in the config."""
CARRIES = ("nothing", "load on its drive", "load on a brake")
FALLS = {
    "gives less", "torque turns", "encoder freezes", "encoder leaps", "lets go", "opposed",
    "quick stop coasts", "limit below the load",
}  # fmt: skip
"""What falls without a brake before anything can hold it (docs/reference/safety-tests.md): it is said."""
BY_BRAKE = {
    "torque turns": 0.35, "opposed": 0.10, "encoder leaps": 0.10, "encoder freezes": 0.20,
}  # fmt: skip
"""How far a loaded axis with a brake may get then [rad]: the same page."""
BLIND = {"encoder freezes", "encoder leaps"}
"""Where that comes before the first motion, nobody sees any: the trial of the signs ends it."""


def _set(**habits: Any) -> Callable[[ForeignDrive], None]:
    def change(drive: ForeignDrive) -> None:
        for name, value in habits.items():
            setattr(drive.habits, name, value)

    return change


EVENTS: dict[str, Callable[[ForeignDrive], None]] = {
    "gives less": _set(gives=5.0),
    "torque turns": _set(turned=True),
    "encoder freezes": lambda drive: setattr(drive.habits, "frozen", drive.seen),
    "encoder leaps": lambda drive: setattr(drive.habits, "frozen", drive.seen - 0.05),
    "lets go": lambda drive: drive.enter("off") if drive.powered else None,
    "brake is worn": _set(brake_good=0),
    "answers late": _set(pdo=0.0045),
    "SDO slow": _set(sdo=0.05),
}
HABITS: dict[str, dict[str, Any]] = {
    "nothing": {}, "opposed": {"opposed": True}, "quick stop coasts": {"lies": True},
    "gives up in torque mode": {"stops_from_torque": False}, "mode shown early": {"shown_early": 0.1},
    "brake opens late": {"brake_opens": 0.9}, "brake of 0.1 s": {"brake": 0.1},
    "SDO in 6 ms": {"sdo": 0.006}, "no mode for 4 s": {"blank": 4.0}, "event PDOs": {"event": 0.01},
    "modes at rest only": {"modes_at_rest": True}, "limit below the load": {"values": {0x60E000: 200}},
}  # fmt: skip
REFUSED = {
    "opposed",
    "quick stop coasts",
    "gives up in torque mode",
    "modes at rest only",
    "limit below the load",
}
"""Habits that may be refused; whoever has another one is measured."""


@dataclass(frozen=True)
class Drawn:
    """One run."""

    kind: str
    phase: str
    carries: str
    load: float
    share: float
    """Of the phase, when it happens."""
    stopped: bool
    """Leaving because a person stops the run, not at its end."""
    permille: int
    """0x6072 as the drive is found."""


def draw(number: int, seed: int) -> Drawn:
    """The situation of a number: all of them once, then anew at other moments."""
    crossed = [
        (kind, phase, carries)
        for kind in ("stop", "master dies", *EVENTS, *HABITS)
        for phase in (PHASES if kind not in HABITS else ["always"])
        for carries in (CARRIES[2:] if kind.startswith("brake ") else CARRIES)
    ]
    rng = np.random.default_rng([seed, number])
    kind, phase, carries = crossed[
        int(np.random.default_rng(seed).permutation(len(crossed))[number % len(crossed)])
    ]
    return Drawn(
        kind, phase, carries,
        load=float(rng.choice([3.0, LOAD])) if carries != CARRIES[0] else 0.0,
        share=float(rng.uniform()), stopped=bool(rng.integers(2)), permille=int(rng.choice([1500, 10_000])),
    )  # fmt: skip


class Killed(Exception):
    """The master dies."""


class OneRun:
    """One `measure`, in which one thing happens at one moment."""

    def __init__(self, drawn: Drawn, folder: Path) -> None:
        self.drawn, self.stop = drawn, threading.Event()
        braked, loaded = drawn.carries == CARRIES[2], drawn.load > 0.0
        more = dict(HABITS.get(drawn.kind, {}))
        values = {0x607200: drawn.permille, **more.pop("values", {})}
        brake = more.pop("brake", 0.03) if braked else None
        habits = Habits(load=drawn.load, brake=brake, values=values, **more)
        axis = {"gravity_loaded": loaded, "brake": "drive" if braked else "none"}
        self.cell = ForeignCell(folder, [habits, Habits(), Habits()], [axis, {"gravity_loaded": False}])
        self.limits = [RATED / 1000 * min(values.values()), LIMIT]
        foreign = self.cell.drives[FOREIGN - 1]
        foreign.nmt, foreign.od[0x101700][1] = 0x05, 100
        self._foreign = self._shown()
        self.marks: list[tuple[float, str]] = []
        self.at_s = math.inf
        self.is_over = False

    def _shown(self) -> tuple[object, ...]:
        foreign = self.cell.drives[FOREIGN - 1]
        return foreign.nmt, foreign.state, {at: entry[1] for at, entry in foreign.od.items()}

    def mark(self, name: str) -> None:
        """A phase begins; whatever is to happen in it is put on the wire."""
        if not self.marks or self.marks[-1][1] != name:
            self.marks.append((self.cell.wire.now, name))

    def measure(self, at: float | None) -> Run | None:
        """What came of it; ``at``: when it happens, ``None``: never, or from a stop on the way out."""
        cell, drawn = self.cell, self.drawn
        if at is not None and drawn.phase == "leaving" and drawn.stopped:
            cell.wire.at(at, self.stop.set)
        elif at is not None:
            self._happens(at)
        try:
            return cell.measure(self.stop, on_phase=self._begins)
        except Killed:
            cell.wire.events.clear()
            return None

    def _begins(self, phase: str) -> None:
        self.mark(phase)
        if phase == "stop" and self.stop.is_set() and self.at_s == math.inf:
            self._happens(self.cell.wire.now + self.drawn.share * LEAVING_S)

    def _happens(self, at: float) -> None:
        self.at_s, kind, drive = at, self.drawn.kind, self.cell.drives[0]

        def die() -> None:
            if not self.is_over:
                raise Killed

        whatever = {"stop": self.stop.set, "master dies": die}
        self.cell.wire.at(at, whatever.get(kind, lambda: EVENTS[kind](drive)))

    def judge(self, ended: Run | None) -> list[str]:
        """Violations, by the plant; two seconds after the end."""
        self.is_over, at_end = True, self.cell.wire.now
        self.cell.wire.advance(at_end + 2.0)
        wrong = [*self._torque(), *self._foreigners()]
        if self.drawn.phase == "always" or self.at_s <= at_end - SEEN_S:  # else nobody was there any more
            wrong += [*self._travel(at_end), *self._words(ended, at_end)]
        return wrong

    def _torque(self) -> list[str]:
        return [
            f"{most:.3g} N·m on A{k}, limit {limit:.3g}"
            for k, (drive, limit) in enumerate(zip(self.cell.drives, self.limits, strict=False), start=1)
            if (most := max(drive.most_asked, drive.most_torque)) > 1.05 * limit
        ]

    def _foreigners(self) -> list[str]:
        commands = [
            f"0x{cob:03X} {data.hex()} was sent to a foreign node"
            for _, cob, data in self.cell.wire.sent
            if (cob == 0x600 + FOREIGN and data[0] >> 5 != 2)
            or cob == 0x200 + FOREIGN
            or (cob == 0 and data[1] in (0, FOREIGN))
        ]
        return commands[:1] or ([] if self._shown() == self._foreign else ["a foreign node was changed"])

    def _travel(self, at_end: float) -> list[str]:
        drawn, drive = self.drawn, self.cell.drives[0]
        if drawn.kind in BLIND and drawn.phase == "enabling":
            return []
        if not drawn.load:
            far = max(
                (abs(x) for _, x, _, state in drive.log if state in ("enabled", "stopping")), default=0.0
            )
            return [f"travel of {far:.2g}"] if far > WINDOW + ROOM else []
        if drawn.carries == CARRIES[1] and drawn.kind in FALLS:
            return []
        fallen = self.cell.fallen(since=min(self.at_s, at_end) if drawn.phase != "always" else 0.0)
        most = BY_BRAKE.get(drawn.kind, HELD) + PLAYED
        return [f"fell by {fallen:.2g}"] if fallen > most else []

    def _words(self, ended: Run | None, at_end: float) -> list[str]:
        if ended is None:
            return []
        drawn, words, wrong = self.drawn, ended.words, []
        moved = self.cell.fallen(since=at_end)
        held = "A1 is energised: it is held by its drive" in words or "its brake holds it" in words
        if held and moved > 0.005:
            wrong.append(f"said to be held, moved by {moved:.2g}")
        if moved > 0.05 and drawn.load and "is not held" not in words and "is without torque" not in words:
            wrong.append(f"falls after the end by {moved:.2g}, unsaid: {words[:200]}")
        if drawn.kind in HABITS and drawn.kind not in REFUSED and ended.error is not None:
            wrong.append(f"healthy, and refused: {words[:200]}")
        return wrong


def timeline(
    drawn: Drawn, folder: Path, known: dict[tuple[float, str], dict[str, float]]
) -> dict[str, float]:
    """When each phase begins in a run with this load to which nothing happens [s]."""
    key = drawn.load, drawn.carries
    if key not in known:
        healthy = OneRun(replace(drawn, kind="nothing", phase="always", permille=10_000), folder)
        healthy.measure(None)
        known[key] = {
            name: now for now, name in reversed([*healthy.marks, (healthy.cell.wire.now, "closed")])
        }
    return known[key]


def run_one(drawn: Drawn, known: dict[tuple[float, str], dict[str, float]]) -> tuple[OneRun, list[str]]:
    """A run, and what it did wrong."""
    at = None
    with tempfile.TemporaryDirectory() as folder:
        if drawn.phase != "always":
            marks = timeline(drawn, Path(folder) / "healthy", known)
            leaving = drawn.phase == "leaving" and drawn.stopped
            low, high = (marks[name] for name in PHASES["run" if leaving else drawn.phase])
            at = low + drawn.share * (high - low)
        one = OneRun(drawn, Path(folder) / "run")
        return one, one.judge(one.measure(at))


def campaign(numbers: Sequence[int], seed: int) -> str:
    """The table of violations; each violation is printed as it comes."""
    count: dict[tuple[str, str], list[int]] = defaultdict(lambda: [0, 0])
    known: dict[tuple[float, str], dict[str, float]] = {}
    for k in numbers:
        drawn = draw(k, seed)
        one, wrong = run_one(drawn, known)
        for phase in (drawn.phase, "all"):
            count[drawn.kind, phase][0] += bool(wrong)
            count[drawn.kind, phase][1] += 1
        for each in wrong:
            print(f"{k}: {drawn}, {one.at_s:.3f} s: {each}", flush=True)
    columns = [*PHASES, "always", "all"]
    table = ["| violations of runs | " + " | ".join(columns) + " |", "| --- " * (len(columns) + 1) + "|"]
    for kind in ("stop", "master dies", *EVENTS, *HABITS):
        cells = (f"{v} of {n}" if n else "" for v, n in (count[kind, c] for c in columns))
        table.append(f"| {kind} | " + " | ".join(cells) + " |")
    return "\n".join(table)


def main() -> None:
    """Run the campaign and print its table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("--seed", type=int, default=7000)
    parser.add_argument("--only", type=int, nargs="*", help="numbers of runs to repeat")
    wished = parser.parse_args()
    print(campaign(wished.only or range(wished.runs), wished.seed))


if __name__ == "__main__":
    main()
