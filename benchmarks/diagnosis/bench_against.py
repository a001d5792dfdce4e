"""Wrong simulators of cells that MuJoCo simulated: judged, corrected, and the copy run on a record kept out.

python benchmarks/diagnosis/bench_against.py 1:13 -o against.jsonl [--budget 60] [--as fmu] [--keep FOLDER]
python benchmarks/diagnosis/bench_against.py --table against.jsonl

A cell of one or two axes with one to three hidden elements is recorded; its XML without them and every
number 5 to 50 % off is judged and corrected, the XML that made the recording is judged as well. ``--as fmu``:
the same as FMUs, with nothing hidden: nobody can change an FMU's equations from outside.
A line of JSON a case; ``--keep`` keeps recordings and diagnoses, and takes them from there the next time.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
from bench_cells import add_lines
from machines.mujoco_cells import SIZES, Cell, drawn, measured, users, write

import invid
from invid.simulators.judge import judge
from invid.simulators.open import open_simulator

REACHED = 1.3
"""Floors within which a corrected copy is called mended."""


def case(seed: int, *, linear: bool) -> Cell:
    """One or two axes of one or two masses, with one to three hidden elements."""
    rng = np.random.default_rng([seed, 391])
    sizes = tuple(int(n) for n in rng.integers(1, 3, rng.integers(1, 3)))
    kinds = () if linear else tuple(str(k) for k in rng.permutation(list(SIZES)))
    cell = drawn(seed, kinds=kinds, sizes=sizes)
    return replace(cell, hidden=cell.hidden[: int(rng.integers(1, 4))])


def off(rng: np.random.Generator, rows: Any) -> tuple[Any, ...]:
    """Every number 5 to 50 % too large, or too small by the same factor."""
    return tuple(
        tuple(float(x * (1.0 + rng.uniform(0.05, 0.5)) ** rng.choice([-1, 1])) for x in r) for r in rows
    )


def simulators(cell: Cell, kind: str, folder: Path) -> tuple[Path, Path]:
    """Files of the true simulator and of a wrong one."""
    rng, texts = np.random.default_rng([cell.seed, 392]), []
    numbers = {n: off(rng, getattr(cell, n)) for n in ("inertia", "springs", "dampers")}
    for name, its in (("true", cell), ("wrong", replace(cell, hidden=(), **numbers))):
        texts.append(folder / f"{name}{cell.seed}.xml")
        texts[-1].write_text(users(its))
    if kind == "xml":
        return texts[0], texts[1]
    made = []
    for text in texts:
        model = open_simulator(text, cell.axes).claimed()
        assert model is not None
        made.append(text.with_suffix(".fmu"))
        invid.export(model, "fmu", made[-1])
    return made[0], made[1]


def told(found: dict[str, Any]) -> dict[str, Any]:
    """What matters of ``against``."""
    sides, axes = ("before", "after"), found["axes"]
    return {
        "right": found["right"],
        **{k: found["held_out"][k] for k in sides},
        "axes": [[round(a[k] / a["noise_floor"], 2) for k in sides if a[k]] for a in axes],
        "parameters": [p["name"] for p in found["parameters"]],
        "missing": [f"{m['cause']} {m['axis']} {m.get('element')}" for m in found["missing"]],
        "cannot_hold": found["cannot_hold"],
        "warnings": found["warnings"],
    }


def one(seed: int, budget: float, kind: str, folder: Path) -> dict[str, Any]:
    """Floors of the true simulator, of the wrong one and of its copy."""
    cell, cpu = case(seed, linear=kind == "fmu"), sum(os.times()[:4])
    out: dict[str, Any] = {
        "seed": seed, "motion": cell.motion, "masses": [len(m) for m in cell.inertia],
        "hidden": [f"{h.kind} {cell.axes[h.axis]} {h.element} size {h.size:.3g}" for h in cell.hidden],
    }  # fmt: skip
    record, known = folder / f"{kind}{seed}.h5", folder / f"{kind}{seed}.json"
    try:
        if not record.exists():
            write(cell, measured(cell), record)
        recording = invid.read_recording(record)
        if not known.exists():
            invid.diagnose(recording, budget=budget).save(known)
        diagnosis = invid.load_diagnosis(known)
        out["diagnosed_cpu_s"] = round(sum(os.times()[:4]) - cpu, 1)
        out["verdict"] = diagnosis.verdict
        out["diagnosis_floors"] = round(max(r.after / r.noise_floor for r in diagnosis.residual), 2)
        out["findings"] = [
            f"{f.cause} {f.axis} {f.element} {f.confidence:.2f} "
            + " ".join(f"{n} {p.value:.3g}" for n, p in f.parameters.items())
            for f in diagnosis.findings
        ]
        true, wrong = simulators(cell, kind, folder)
        for name, path in (("true", true), ("wrong", wrong)):
            mended = folder / f"mended{seed}.{'json' if kind == 'fmu' else kind}" if name == "wrong" else None
            out[name] = told(judge(recording, diagnosis, open_simulator(path, recording.axes), mended))
    except invid.InvidError as error:
        out["error"] = str(error)
    out["cpu_s"] = round(sum(os.times()[:4]) - cpu, 1)
    return out


def table(rows: list[dict[str, Any]]) -> None:
    """The two shares, and every case."""
    done = [r for r in rows if "wrong" in r]
    after = [r["wrong"]["after"] if r["wrong"]["after"] is not None else r["wrong"]["before"] for r in done]
    named = [a for a, r in zip(after, done, strict=True) if r["diagnosis_floors"] <= REACHED]
    print(f"true called right: {sum(r['true']['right'] for r in done)} of {len(rows)}")
    print(f"copy within {REACHED} floors: {sum(a <= REACHED for a in after)} of {len(rows)}; ", end="")
    print(f"where the diagnosis itself reaches it: {sum(a <= REACHED for a in named)} of {len(named)}")
    print("\nseed | motion | hidden | found | floors: diagnosis, true, wrong, copy | cannot hold")
    for r in rows:
        head = f"{r['seed']} | {r['motion']} {r['masses']} | {', '.join(r['hidden']) or 'nothing'}"
        if "wrong" not in r:
            print(f"{head} | error: {r.get('error')}")
            continue
        t, w = r["true"], r["wrong"]
        found = ", ".join(r["findings"]) or "nothing"
        copy = "none" if w["after"] is None else f"{w['after']:.2f}"
        print(
            f"{head} | {found} | {r['diagnosis_floors']}, {t['before']:.2f}, {w['before']:.3g}, {copy} | "
            f"{'; '.join(w['cannot_hold'] + w['warnings'])}"
        )


def main() -> None:
    """Runs or tabulates."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="?", default="1:11", help="first:last+1")
    parser.add_argument("-o", "--out", type=Path, default=Path("against.jsonl"))
    parser.add_argument("--budget", type=float, default=60.0)
    parser.add_argument("--as", dest="kind", choices=("xml", "fmu"), default="xml")
    parser.add_argument("--keep", type=Path, help="folder of the recordings, diagnoses and simulators")
    parser.add_argument("--table", type=Path, help="JSON lines to tabulate")
    args = parser.parse_args()
    if args.table is None:
        first, last = (int(n) for n in args.seeds.split(":"))
        with tempfile.TemporaryDirectory() as scratch:
            folder = args.keep or Path(scratch)
            folder.mkdir(parents=True, exist_ok=True)
            add_lines(args.out, (one(seed, args.budget, args.kind, folder) for seed in range(first, last)))
    table([json.loads(line) for line in (args.table or args.out).read_text().splitlines()])


if __name__ == "__main__":
    main()
