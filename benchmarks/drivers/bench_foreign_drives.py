"""Situations crossed with phases on foreign drives in virtual time, judged on the true motion of the plant.

    python benchmarks/drivers/bench_foreign_drives.py --runs 300 --seed 7000

Each run draws what an axis carries and what holds it (nothing, a load held by its drive, a load on a
brake), one situation and the moment at which it comes. Wire, drives and plant:
`tests/contract/foreign_wire.py`. A violation is

- torque above the limit by more than 5 %, travel of an axis without load beyond window and stated room;
- a loaded axis more than 0.02 rad from where it was, beyond what is played and the bounds of ``PHYSICS``;
- "held by its drive" of an axis that moves, or no word of one that is not held;
- a healthy cell that is not measured.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import threading
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "contract")]

from foreign_wire import LIMIT, LOAD, WINDOW, ForeignCell, ForeignDrive, Habits, Run  # noqa: E402

PHASES = {
    "enabling": (4.2, 4.8),
    "at rest": (5.0, 9.5),
    "stop test": (9.5, 14.0),
    "trial": (14.5, 22.0),
    "run": (24.0, 33.0),
}
HELD, PLAYED, ROOM = 0.02, 0.03, 0.5
"""A loaded axis may be so far from where it was in one event; what is played; beyond the window [rad]."""
CARRIES = ("nothing", "load on its drive", "load on a brake")
PHYSICS = {
    **dict.fromkeys(("gives less", "encoder freezes", "lets go", "quick stop coasts"), CARRIES[1:2]),
    **dict.fromkeys(("encoder leaps", "torque turns", "opposed"), CARRIES[1:]),
}
"""What falls before anything can hold it (docs/reference/safety-tests.md): that it does not stand has to be
said."""


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
    "brake opens late": {"brake_opens": 0.9},
    "SDO in 6 ms": {"sdo": 0.006}, "no mode for 4 s": {"blank": 4.0},
}  # fmt: skip
HEALTHY = {"nothing", "mode shown early", "brake opens late", "SDO in 6 ms", "no mode for 4 s"}
KINDS = ("stop", "master dies", *EVENTS, *HABITS)


@dataclass(frozen=True)
class Drawn:
    """One run."""

    kind: str
    phase: str
    at_s: float
    carries: str
    seed: int


def draw(kind: str, rng: np.random.Generator, seed: int) -> Drawn:
    """A load and a moment for a kind; what a drive is used to has no moment."""
    phase = "always" if kind in HABITS else str(rng.choice(list(PHASES)))
    low, high = PHASES.get(phase, (4.2, 4.2))
    return Drawn(kind, phase, float(rng.uniform(low, high)), str(rng.choice(CARRIES)), seed)


class Killed(Exception):
    """The master dies."""


def run_one(drawn: Drawn, folder: Path) -> tuple[Run | None, ForeignCell, list[str]]:
    """What came of a run, and what it did wrong."""
    loaded = drawn.carries != "nothing"
    brake = 0.03 if drawn.carries == "load on a brake" else None
    habits = Habits(load=LOAD if loaded else 0.0, brake=brake, **HABITS.get(drawn.kind, {}))
    axis = {"gravity_loaded": loaded, "brake": "drive" if brake else "none"}
    cell = ForeignCell(folder, [habits, Habits()], [axis, {"gravity_loaded": False}])
    stop, ended = threading.Event(), None
    drive = cell.drives[0]

    def die() -> None:
        raise Killed

    if drawn.kind == "stop":
        cell.wire.at(drawn.at_s, stop.set)
    elif drawn.kind == "master dies":
        cell.wire.at(drawn.at_s, die)
    elif drawn.kind in EVENTS:
        cell.wire.at(drawn.at_s, lambda: EVENTS[drawn.kind](drive))
    try:
        ended = cell.measure(stop)
    except Killed:
        cell.wire.events.clear()
    at_end = cell.wire.now
    cell.wire.advance(at_end + 1.5)
    return ended, cell, judge(drawn, ended, cell, at_end)


def judge(drawn: Drawn, ended: Run | None, cell: ForeignCell, at_end: float) -> list[str]:
    """Violations, by the plant."""
    drive, wrong = cell.drives[0], []
    for k, each in enumerate(cell.drives):
        if each.most_torque > 1.05 * LIMIT:
            wrong.append(f"{each.most_torque:.3g} N·m on A{k + 1}")
    physics = drawn.carries in PHYSICS.get(drawn.kind, ())
    words = ended.words if ended is not None else ""
    moved_after = cell.fallen(since=at_end)
    if "A1 is energised: it is held by its drive" in words and moved_after > 0.005:
        wrong.append(f"said to be held, moved by {moved_after:.2g}")
    if drawn.carries == "nothing":
        powered = [abs(x) for _, x, _, state in drive.log if state in ("enabled", "stopping")]
        if max(powered, default=0.0) > WINDOW + ROOM:
            wrong.append(f"travel of {max(powered):.2g}")
    else:
        since = drawn.at_s if drawn.phase != "always" else 0.0
        fallen = cell.fallen(since=since)
        unsaid = "is not held" not in words and "is without torque" not in words
        if not physics and fallen > HELD + PLAYED:
            wrong.append(f"fell by {fallen:.2g}")
        if moved_after > 0.05 and unsaid and ended is not None:
            wrong.append(f"falls after the end by {moved_after:.2g}, unsaid")
    if drawn.kind in HEALTHY and (ended is None or ended.error is not None):
        wrong.append(f"healthy, and refused: {words[:120]}")
    return wrong


def campaign(runs: int, seed: int, kinds: tuple[str, ...] = KINDS) -> tuple[str, list[str]]:
    """The table of violations over runs, and each violation in a line."""
    count: dict[tuple[str, str], list[int]] = defaultdict(lambda: [0, 0])
    lines = []
    for k in range(runs):
        rng = np.random.default_rng([seed, k])
        drawn = draw(kinds[k % len(kinds)], rng, k)
        with tempfile.TemporaryDirectory() as folder:
            _, _, wrong = run_one(drawn, Path(folder))
        cell = count[drawn.kind, drawn.carries]
        cell[0] += bool(wrong)
        cell[1] += 1
        lines += [
            f"{k}: {drawn.kind}, {drawn.phase} ({drawn.at_s:.2f} s), {drawn.carries}: {w}" for w in wrong
        ]
    table = ["| violations of runs | " + " | ".join(CARRIES) + " |", "| --- " * 4 + "|"]
    for kind in kinds:
        cells = (f"{v} of {n}" for v, n in (count[kind, c] for c in CARRIES))
        table.append(f"| {kind} | " + " | ".join(cells) + " |")
    return "\n".join(table), lines


def main() -> None:
    """Run the campaign and print its table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("--seed", type=int, default=7000)
    wished = parser.parse_args()
    table, lines = campaign(wished.runs, wished.seed)
    print("\n".join([*lines, "", table]))


if __name__ == "__main__":
    main()
