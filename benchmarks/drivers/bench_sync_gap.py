"""Longest gap in SYNC while an axis is energised, with drives that are slow in SDO and in changing modes.

    python benchmarks/drivers/bench_sync_gap.py [--runs 20] [--seed 0] [--markdown]

Whole measurements of the case study in virtual time at 250 Hz; every axis draws how long its drive takes to
answer SDO (2 to 200 ms), to change its mode and to show it (up to 0.4 s each) and to enable (up to 0.3 s).
Judged on the frames on the wire and on the states of the drives themselves. The bar is three cycles.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import can
import numpy as np
import yaml

from invid.config import CellConfig, parse_config
from invid.errors import InvidError
from invid.planning import make_plan
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.measurement import run_measurement
from invid_drivers.simulated import VirtualTimeBus, open_virtual_bus

CONFIG = Path(__file__).parents[2] / "configs" / "case-study.yaml"
CYCLE_S, MOST_CYCLES = 0.004, 3.0
ENERGISED = {"OPERATION_ENABLED", "QUICK_STOP_ACTIVE", "FAULT_REACTION_ACTIVE"}


def cell_config(rng: np.random.Generator) -> tuple[CellConfig, float]:
    """The cell, and its slowest answer [s]."""
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    data["bus"]["cycle_s"] = CYCLE_S
    data["experiments"] = [
        {"kind": "multisine", "band_Hz": [1, 12], "period_s": 2.048, "periods": 2, "settle_periods": 0,
         "experiments": 1}
    ]  # fmt: skip
    slowest = 0.0
    for settings in data["simulation"]["axes"].values():
        answer = float(np.exp(rng.uniform(np.log(0.002), np.log(0.2))))
        slowest = max(slowest, answer)
        settings |= {
            "sdo_response_s": answer,
            "mode_change_s": float(rng.uniform(0.0, 0.4)),
            "mode_display_s": float(rng.uniform(0.0, 0.4)),
            "enable_s": float(rng.uniform(0.0, 0.3)),
        }
    return parse_config(yaml.safe_dump(data)), slowest


def run_one(rng: np.random.Generator, folder: Path) -> tuple[float, float, int, str]:
    """Longest gap [cycles], slowest answer [s], SYNCs, and what the run ended with."""
    config, slowest = cell_config(rng)
    port = open_virtual_bus(config)
    if not isinstance(port, VirtualTimeBus):
        raise TypeError("the bus is not virtual")
    cell, send = port.wire.cell, port.send
    syncs: list[tuple[float, bool]] = []

    def seen(msg: can.Message, timeout: float | None = None) -> None:
        if msg.arbitration_id == 0x80:
            syncs.append((port.clock.now(), any(d.state.name in ENERGISED for d in cell.drives)))
        send(msg, timeout)

    port.send = seen  # type: ignore[method-assign]
    said = ""
    try:
        run_measurement(config, make_plan(config), Cia402Cell(port, config), folder / "run.h5")
    except InvidError as error:
        said = str(error)
    pairs = pairwise(syncs)
    gap = max((after - before for (before, on), (after, _) in pairs if on), default=0.0)
    return gap / CYCLE_S, slowest, len(syncs), said


def main() -> int:
    """Run and print; 1 where a gap was longer than the bar, or a run did not end well."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--markdown", action="store_true")
    arguments, _ = parser.parse_known_args()
    rows: list[Any] = []
    with tempfile.TemporaryDirectory() as folder:
        for n in range(arguments.runs):
            rows.append(run_one(np.random.default_rng([arguments.seed, n]), Path(folder)))
    gaps = [r[0] for r in rows]
    head = ("runs", "SYNCs", "slowest SDO answer", "longest gap: median", "worst", f"beyond {MOST_CYCLES:g}")
    late = sum(g > MOST_CYCLES + 1e-6 for g in gaps)
    line = (
        str(len(rows)), str(sum(r[2] for r in rows)), f"{max(r[1] for r in rows) * 1e3:.0f} ms",
        f"{np.median(gaps):.2f} cycles", f"{max(gaps):.2f} cycles", str(late),
    )  # fmt: skip
    mark = arguments.markdown
    for k, cells in enumerate((head, line)):
        print("| " + " | ".join(cells) + " |" if mark else "  ".join(f"{c:<20}" for c in cells))
        if mark and not k:
            print("| --- " * len(head) + "|")
    failed = [said for *_, said in rows if said]
    for said in failed:
        print(f"a run ended early: {said}")
    return 1 if late or failed else 0


if __name__ == "__main__":
    sys.exit(main())
