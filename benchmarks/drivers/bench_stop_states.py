"""From a person's stop to standing, by the state in which it met an axis, beside the bound of the table.

    python benchmarks/drivers/bench_stop_states.py [--runs 6] [--seed 1]

Foreign drives in virtual time (`tests/machines/foreign`), 0 to 3 loads. Of each state ``--runs`` stops,
each some cycles after an axis has come into it. Standing: the plant's last motion (0.02 rad/s) of any axis
until the bus is free. The bound is the longest way through the table of states, every deadline used up, to a
state in which an axis stands or nothing can be done for it, after the torque was faded out. 1 where it was
exceeded.
"""

from __future__ import annotations

import argparse
import contextlib
import random
import sys
import tempfile
import threading
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT)]

from invid.config import load_config  # noqa: E402
from invid.errors import InvidError  # noqa: E402
from invid.sweep.motion import FADE_S  # noqa: E402
from invid_drivers.cia402.axis_state import CHANGING_S, NEXT, RULES, AxisState  # noqa: E402
from invid_drivers.cia402.bus import Cia402Cell  # noqa: E402
from invid_drivers.measurement import run_measurement  # noqa: E402
from invid_drivers.stopping_budgets import Wish  # noqa: E402
from tests.machines.foreign.cell import TRACE, Cell  # noqa: E402
from tests.machines.foreign.draft import ALWAYS, draw_cell  # noqa: E402
from tests.machines.foreign.judge import AT_REST  # noqa: E402
from tests.machines.foreign.kinds import KINDS  # noqa: E402
from tests.machines.foreign.wire import ForeignWire  # noqa: E402

S = AxisState
MEETS = {
    S.OFF: ("ordinary",), S.ENABLING: ("ordinary", "late brake"), S.HELD: ("ordinary", "late brake"),
    S.LED: ("ordinary", "brake after torque"), S.SWITCHING: ("modes at rest",), S.STOPPING: ("ordinary",),
    S.PARKING: ("ordinary",), S.STANDS: ("ordinary", "lets go in quick stop"),
    S.BRAKING: ("brake after torque", "late brake", "brake fails"), S.BRAKED: ("heavy load", "late brake"),
    S.CATCHING: ("lets go in quick stop", "brake fails", "late brake"), S.CAUGHT: ("lets go in quick stop",),
    S.LETTING_GO: ("ordinary",),
}  # fmt: skip
"""Kinds in which an axis comes into each state before the way out."""
ENDS = {
    S.LED: (S.STOPPING, S.PARKING), S.HELD: (S.BRAKING, S.PARKING), S.ENABLING: (S.PARKING, S.LETTING_GO),
    S.SWITCHING: (S.PARKING, S.LETTING_GO), S.OFF: (S.CATCHING,), S.STANDS: (S.BRAKING, S.CATCHING),
    S.BRAKED: (S.CATCHING,),
}  # fmt: skip
"""What the way out wishes at once."""
STANDING = (S.STANDS, S.BRAKED, S.CAUGHT, S.OFF, S.FAULT, S.LOST, S.UNHEARD)
MEANS = (S.BRAKING, S.CATCHING, S.LOST)
IN_TIME_S = 0.02
"""A brake that is not given up."""
LATER, SHAKEN = (0, 3, 20, 90), (400, 900, 1300, 60)
"""Cycles that an axis has been in its state by then; one that is led, so that it is shaken."""


def bound(state: AxisState, seen: frozenset[AxisState] = frozenset()) -> float:
    """Longest time to a state in which it stands, by the deadlines of the table, each means once [s]."""
    if state in seen or (seen and state in STANDING):
        return 0.0
    rule, seen = RULES[state], seen | {state}
    ends = ENDS.get(state)
    after = ends if ends is not None else (rule.then, rule.late, rule.falls)
    after = tuple(x for a in after if a is not None for x in (MEANS if a is NEXT else (a,)))
    own = 0.0 if ends is not None or np.isinf(rule.within_s) else rule.within_s
    own += CHANGING_S * (state is S.STOPPING)
    return own + max((bound(a, seen) for a in after), default=0.0)


def stopped(kind: str, loads: int, seed: int, met: tuple[AxisState, int]) -> float | None:
    """Seconds from a stop until every axis stands; ``None`` where no axis came into the state."""
    d = draw_cell(kind, ALWAYS, loads, seed, brakes=KINDS[kind].brakes)
    d.victims = list(d.axes)
    KINDS[kind].make(d)
    if met[0] in (S.SWITCHING, S.BRAKED):
        for axis in d.axes:
            axis.brake = IN_TIME_S if axis.load else None
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        written = Cell(folder, d.spec(), d.config())
        (folder / "events.json").write_text("[]")
        wire, config = ForeignWire(name), load_config(written.config)
        cell, stop = Cia402Cell(wire, config), threading.Event()
        tick, at, count = cell.tick, [0.0], 0

        def watched(wish: Any) -> Any:
            nonlocal count
            sample = tick(wish)
            count = count + 1 if any(a.state is met[0] for a in cell._supervised.axes) else 0
            if count > met[1] and not stop.is_set() and not cell._supervised.is_leaving:
                at[0] = wire.now()
                stop.set()
            return sample

        cell.tick = watched  # type: ignore[method-assign]
        with contextlib.suppress(InvidError):
            run_measurement(config, Wish(), cell, folder / "out.h5", stop=stop)
        over = wire.world.marks["over"]
        wire.world.flush()
        rows = np.frombuffer((folder / "trace.bin").read_bytes(), TRACE)
    if not stop.is_set():
        return None
    moving = rows[(rows["t"] >= at[0]) & (rows["t"] <= over) & (np.abs(rows["v"]) > AT_REST)]
    return float(moving["t"].max() - at[0]) if len(moving) else 0.0


def main() -> int:
    """Draw, stop, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=6)
    parser.add_argument("--seed", type=int, default=1)
    wished, _ = parser.parse_known_args()
    found: dict[AxisState, list[float]] = defaultdict(list)
    for state, kinds in MEETS.items():
        rng, later = random.Random(f"{wished.seed}/{state}"), SHAKEN if state is S.LED else LATER
        for n in range(wished.runs):
            kind = kinds[n % len(kinds)]
            loads = rng.choice(KINDS[kind].loads)
            took = stopped(kind, loads, wished.seed * 1000 + n, (state, later[n % len(later)]))
            found[state] += [] if took is None else [took]
    print("| stopped while | stops | standing after, longest [s] | bound [s] |\n| --- | --- | --- | --- |")
    for state in MEETS:
        most = f"{max(found[state]):.2f}" if found[state] else ""
        print(f"| {state.value} | {len(found[state])} | {most} | {FADE_S + bound(state):.1f} |")
    return int(any(max(t, default=0.0) > FADE_S + bound(s) for s, t in found.items()))


if __name__ == "__main__":
    sys.exit(main())
