"""Identification from a run on a bad day: 5 % of the TPDOs lost, and a computer that wakes late.

    python benchmarks/drivers/bench_lossy.py [--loss 0.05] [--late 0.02] [--seed 0]

The paper's case study in virtual time at 1 kHz. ``late`` of the cycles wake late by an exponentially
distributed time of 2 ms, as measured on a machine with a load of six on two cores; the cycle then skips
slots or sends SYNC up to half a cycle late, and the recording has the true instants. Prints every parameter
with its truth, estimate and distance in standard deviations; the exit status is 1 where the truth is not
within three.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from invid.config import parse_config
from invid.identification.identify import identify
from invid.model.document import model_to_json
from invid.planning import make_plan
from invid.recording import read_recording
from invid_drivers.cia402.bus import Cia402Cell
from invid_drivers.measurement import run_measurement
from invid_drivers.simulated import open_virtual_bus
from invid_drivers.simulated.config import truth

CONFIG = Path(__file__).parents[2] / "configs" / "case-study.yaml"
MEAN_LATE_S = 0.002


def measure(out: Path, *, loss: float, late: float, seed: int) -> dict[str, Any]:
    """The recording of a bad day; what was lost."""
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    # an interruption of tens of milliseconds is part of the day
    data["safety"] = {"missed_tpdos": 100, "overrun_cycles": 100, "heartbeat_s": 0.5}
    tpdos = [0x180 + a["node_id"] for a in data["axes"]]
    faults = [{"kind": "drop", "can_ids": tpdos, "rate": loss, "at_s": 0.0}] if loss else []
    data["simulation"] = {**data["simulation"], "seed": seed, "faults": faults}
    config = parse_config(yaml.safe_dump(data))
    bus = open_virtual_bus(config)
    rng = np.random.default_rng([seed, 1])
    sleep_until = bus.clock.sleep_until

    def sleep(instant: float) -> None:
        sleep_until(instant + (rng.exponential(MEAN_LATE_S) if rng.random() < late else 0.0))

    bus.clock.sleep_until = sleep  # type: ignore[assignment,method-assign]
    result = run_measurement(config, make_plan(config), Cia402Cell(bus, config), out)
    return {"truth": truth(config), "result": result}


def distances(recording: Path, chains: Any) -> list[tuple[str, float, float, float]]:
    """(name, truth, estimate, standard deviation) of every mass, spring and coupling."""
    masses = tuple(len(m) for m in chains.masses)
    document = model_to_json(identify(read_recording(recording), masses=masses))
    rows: list[tuple[str, float, float, float]] = []
    for b, branch in enumerate(document["branches"]):
        for kind, found, true in (
            ("mass", branch["masses"], chains.masses[b]),
            ("spring", branch["springs"], chains.springs[b]),
        ):
            for k, (estimate, value) in enumerate(zip(found, true, strict=True), start=1):
                name = f"{branch['axis']} {kind} {k}"
                rows.append((name, float(value), estimate["value"], estimate["std"] or float("nan")))
    return rows


def main() -> int:
    """Measure, identify, compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loss", type=float, default=0.05)
    parser.add_argument("--late", type=float, default=0.02)
    parser.add_argument("--seed", type=int, default=0)
    arguments, _ = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run.h5"
        day = measure(out, loss=arguments.loss, late=arguments.late, seed=arguments.seed)
        rows = distances(out, day["truth"])
    result = day["result"]
    print(
        f"{result.duration_s:.0f} s of robot time; TPDOs lost {result.missed_tpdos}, SYNC slots skipped "
        f"{result.skipped_slots}"
    )
    worst = 0.0
    for name, true, value, std in rows:
        z = (value - true) / std
        worst = max(worst, abs(z)) if np.isfinite(z) else float("inf")
        print(f"{name:<14}{true:>10.4g}{value:>12.6g} ± {std:<9.2g} {z:+.2f}")
    print(f"worst distance from the truth: {worst:.2f} standard deviations (bar 3)")
    return 0 if worst <= 3 else 1


if __name__ == "__main__":
    sys.exit(main())
