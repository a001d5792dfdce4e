"""What a diagnosis says that the recording would have shown (``ruled_out``), against causes of that size.

python benchmarks/diagnosis/bench_limits.py 0:10 -o limits.jsonl [--causes backlash,gravity] [--axes 1]
python benchmarks/diagnosis/bench_limits.py --table limits.jsonl

A seed is a plant with nothing hidden. Of every cause one place with a limit is drawn; the cause goes in
there at 1.3 times and at half of the limit. Its other numbers (cycles, phase, frequency, knee) are those that
the limit is for; with ``--drawn`` as the hidden tests draw them, where a cause may show at less than its
limit. The simulator is that of tests/hidden. A line of JSON a diagnosis.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
from bench_cells import add_lines
from hidden.causes import CATALOGUE, Cause, available
from hidden.generator import TrueEffect
from hidden.measurement import Active, record, scales
from hidden.plants import random_plant
from hidden.scoring import at_place
from hidden.setup import Setup, draw_setup

import invid
from invid.model.diagnosis_document import RuledOut

FACTORS = 1.3, 0.5
"""Times the limit: the first is to be found in nine of ten, the second in at most half."""
UNLIMITED = ("dropped_samples", "spring_damping", "torque_saturation", "payload_change", "parameter_drift")
"""Without a limit or, of the last three, with one that is no factor of the size or depends on a moment."""
LARGER = {
    "coulomb_friction": ("stribeck_friction", "asymmetric_friction", "presliding_friction"),
    "viscous_friction": ("asymmetric_friction",),
}
"""Laws that contain another: near it."""


def drawn(seed: int, axes: int) -> Setup:
    """A plant with its drives, sensors and plan."""
    rng = np.random.default_rng([seed, 39])
    sizes = tuple(int(n) for n in rng.integers(2, 4 if axes == 1 else 3, axes))
    plant = random_plant(rng, ("A1", "A2")[:axes], sizes)
    return draw_setup(rng, plant, moves=False, periods=2, from_rest=False)


def measured(setup: Setup, noise: int, active: tuple[Active, ...] = ()) -> invid.Recording:
    """The recording with a cause, or without; ``noise``: seed of its noise."""
    count = [len(m) for m in setup.plant.chains.masses]
    return record(np.random.default_rng([noise, 40]), setup, active, count)[0]


def injected(
    rng: np.random.Generator, setup: Setup, cause: Cause, limit: RuledOut, *, at_limit: bool
) -> tuple[Active, float]:
    """The cause at the limit's place, of the shape that the limit is for or of one drawn, and its size."""
    axes = setup.plant.chains.axes
    axis, other = axes.index(limit.axis), -1 if limit.other_axis is None else axes.index(limit.other_axis)
    element = int(limit.element.split()[1]) if limit.element else int(cause.where == "motor")
    p = cause.draw(rng, setup.plant, scales(setup), axis, element, other)
    assert limit.limit is not None
    size = limit.limit
    if cause.name == "asymmetric_friction":  # what it has beyond dry friction; nothing that is viscous
        p = dict.fromkeys(p, 0.0) | {str(rng.choice(["coulomb_positive", "coulomb_negative"])): size}
    elif at_limit and cause.name == "stribeck_friction":
        p = {"static": 2.0 * size, "coulomb": size, **limit.at}
    elif at_limit:
        whole = {limit.parameter: 1.0 + size if cause.name == "torque_gain" else size, **limit.at}
        p = {name: whole[name] for name in p}
    elif cause.name == "stribeck_friction":
        size = p["static"] - p["coulomb"]
    else:
        size = abs(p[limit.parameter] - (1.0 if cause.name == "torque_gain" else 0.0))
    return Active(cause, axis, element, other, p), size


def outcome(hidden: TrueEffect, found: invid.Diagnosis) -> str:
    """ "found"; "near" (a law that contains it, or it among the alternatives); "elsewhere" (its name at
    another place); "other"; "unnamed"; "silent"."""
    here = [f for f in found.findings if at_place(hidden, f.axis, f.element, f.other_axis)]
    if any(f.cause == hidden.cause for f in here):
        return "found"
    listed = [
        a.cause == hidden.cause and at_place(hidden, a.axis, a.element, a.other_axis)
        for f in found.findings
        for a in f.alternatives
    ]
    if any(listed) or any(f.cause in LARGER.get(hidden.cause, ()) for f in here):
        return "near"
    if any(f.cause == hidden.cause for f in found.findings):
        return "elsewhere"
    if found.findings:
        return "other"
    return "silent" if found.verdict == "consistent" else "unnamed"


def diagnosed(recording: invid.Recording, budget: float) -> tuple[invid.Diagnosis | None, dict[str, Any]]:
    """The diagnosis and what a line says of every one."""
    begun, cpu = time.monotonic(), sum(os.times()[:4])
    try:
        found = invid.diagnose(recording, budget=budget)
    except invid.InvidError as error:
        return None, {"error": str(error)}
    return found, {
        "verdict": str(found.verdict),
        "findings": [[f.cause, f.axis, f.element, round(f.confidence, 2)] for f in found.findings],
        "cpu_s": round(sum(os.times()[:4]) - cpu, 1),
        "wall_s": round(time.monotonic() - begun, 1),
    }


def case(seed: int, axes: int, causes: list[str], budget: float, *, at_limit: bool) -> list[dict[str, Any]]:
    """The null of a seed and what was put into it."""
    setup = drawn(seed, axes)
    null, said = diagnosed(measured(setup, seed), budget)
    settings = {k: setup.settings[k] for k in ("drive", "noise", "masses", "rate", "inside_drive")}
    out = [{"seed": seed, "cause": None, **settings, **said}]
    if null is None or null.findings:
        return out
    for name in causes:
        own = np.random.default_rng([seed, *name.encode()])
        there = [r for r in null.ruled_out if r.cause == name]
        limits = [r for r in there if r.limit is not None and is_hidden_there(setup, r)]
        if not limits:
            out.append({"seed": seed, "cause": name, "why": sorted({str(r.why) for r in there})})
            continue
        limit, cause = limits[int(own.integers(len(limits)))], CATALOGUE[name]
        whole, size = injected(own, setup, cause, limit, at_limit=at_limit)
        for factor in FACTORS:
            assert limit.limit is not None
            active = replace_size(whole, factor * limit.limit / size)
            place = setup.plant.chains.axes
            hidden = TrueEffect(
                name,
                place[active.axis],
                cause.element_name(setup.plant, active.axis, active.element),
                place[active.other] if active.other >= 0 else None,
                active.parameters,
                True,
                name == "torque_gain" and setup.plant.count == 2,
            )
            found, said = diagnosed(measured(setup, seed, (active,)), budget)
            line = {"seed": seed, "cause": name, "axis": limit.axis, "element": limit.element}
            line |= {"factor": factor, "limit": limit.limit, "put in": active.parameters}
            out.append({**line, "said": "error" if found is None else outcome(hidden, found), **said})
    return out


def is_hidden_there(setup: Setup, limit: RuledOut) -> bool:
    """Whether the simulator hides the cause at such a place: weights hang at the ends alone."""
    if limit.cause != "gravity":
        return True
    sizes = setup.plant.chains.masses_per_branch
    return limit.element == f"mass {sizes[setup.plant.chains.axes.index(limit.axis)]}"


def replace_size(active: Active, factor: float) -> Active:
    """The cause ``factor`` times as large."""
    p = active.cause.resize(active.parameters, factor)
    return Active(active.cause, active.axis, active.element, active.other, p)


def rows(lines: list[dict[str, Any]]) -> list[str]:
    """Counts of a campaign, a cause a row."""
    nulls = [c for c in lines if c["cause"] is None]
    loud = sum(bool(c.get("findings")) for c in nulls)
    out = [f"{len(nulls)} nulls, {loud} with a cause; CPU s {sum(c.get('cpu_s', 0.0) for c in lines):.0f}"]
    out.append("| cause | found at 1.3 | near | otherwise | found at 0.5 | near | no limit |")
    out.append("| --- " * 7 + "|")
    for name in sorted({c["cause"] for c in lines if c["cause"]}):
        own = [c for c in lines if c["cause"] == name]
        row = [name]
        for factor in FACTORS:
            said = [c["said"] for c in own if c.get("factor") == factor]
            row += [f"{said.count('found')} of {len(said)}", str(said.count("near"))]
            if factor > 1.0:
                rest = [s for s in said if s not in ("found", "near")]
                row.append(", ".join(f"{s} {rest.count(s)}" for s in sorted(set(rest))))
        out.append("| " + " | ".join([*row, str(sum("why" in c for c in own))]) + " |")
    return out


def main() -> None:
    """Runs or tabulates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="?", default="0:10", help="first:last+1")
    parser.add_argument("-o", "--out", type=Path, default=Path("limits.jsonl"))
    parser.add_argument("--axes", type=int, default=1)
    parser.add_argument("--causes", help="separated by commas; all that have a limit where not given")
    parser.add_argument("--drawn", action="store_true", help="cycles, phase, frequency and knee as drawn")
    parser.add_argument("--budget", type=float, default=60.0)
    parser.add_argument("--table", type=Path, nargs="+", help="JSON lines to tabulate")
    args = parser.parse_args()
    if args.table:
        print("\n".join(rows([json.loads(s) for path in args.table for s in path.read_text().splitlines()])))
        return
    every = [n for n in available(CATALOGUE, args.axes, linear=False) if n not in UNLIMITED]
    causes = args.causes.split(",") if args.causes else every
    first, last = (int(n) for n in args.seeds.split(":"))
    asked = args.axes, causes, args.budget
    cases = (case(seed, *asked, at_limit=not args.drawn) for seed in range(first, last))
    add_lines(args.out, (line for lines in cases for line in lines))


if __name__ == "__main__":
    main()
