"""Elastic axes recorded without a period (``tests/hidden/aperiodic.py``): identified, diagnosed.

    python benchmarks/identification/bench_aperiodic.py --from 880000 --count 30 [--diagnose] [-o CASES.jsonl]

A line of JSON a case: number of masses right, the largest deviation of a mass or a spring in standard
deviations and in per cent, χ²/ν against the noise, seconds of processor; with ``--diagnose`` the verdict, and
what was named that is not there (only dry and viscous friction at the motor are). Then the counts of all. The
bar: the number right and all within three standard deviations in 95 %.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from hidden.aperiodic import draw  # noqa: E402

import invid  # noqa: E402
from invid.errors import InvidError  # noqa: E402

WITHIN = 3.0
"""Standard deviations of the bar."""
TRUE = ("coulomb_friction", "viscous_friction", "stribeck_friction", "asymmetric_friction")
"""Causes that are there, or whose law contains what is."""


def case(seed: int, *, diagnose: bool) -> dict[str, Any]:
    """What one draw was answered with."""
    recording, truth = draw(seed)
    out: dict[str, Any] = {"seed": seed, "motion": truth.motion, "masses": truth.masses.size}
    begun = time.process_time()
    try:
        model = invid.identify(recording)
    except InvidError as error:
        return {**out, "error": str(error), "order": False, "within": False}
    found, std = model.chains, model.std
    out |= {"found": found.masses[0].size, "chi2": _rounded(model.fit.get("noise_chi2_per_dof"))}
    out |= {
        "trustworthy": bool(model.fit.get("trustworthy")),
        "identify_s": _rounded(time.process_time() - begun),
    }
    out["order"] = found.masses[0].size == truth.masses.size
    out["within"] = False
    if out["order"]:
        true = np.concatenate((truth.masses, truth.springs))
        off = np.concatenate((found.masses[0], found.springs[0])) - true
        away = np.abs(off / np.concatenate((std.masses[0], std.springs[0])))
        out |= {"sigma": _rounded(away.max()), "per_cent": _rounded(100.0 * np.abs(off / true).max())}
        out["within"] = bool(away.max() < WITHIN)
    if diagnose:
        begun = time.process_time()
        result = invid.diagnose(recording, model=model)
        names = [(f.cause, f.axis, round(f.confidence, 3)) for f in result.findings]
        out |= {
            "verdict": result.verdict,
            "findings": names,
            "diagnose_s": _rounded(time.process_time() - begun),
        }
        out["wrong"] = [name for name in names if name[0] not in TRUE]
    return out


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.3g}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--from", dest="first", type=int, default=880000, metavar="SEED")
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--diagnose", action="store_true")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    cases = []
    for seed in range(options.first, options.first + options.count):
        cases.append(case(seed, diagnose=options.diagnose))
        line = json.dumps(cases[-1])
        print(line, flush=True)
        if options.output:
            with options.output.open("a", encoding="utf-8") as file:
                file.write(line + "\n")
    seconds = [c["identify_s"] for c in cases if "identify_s" in c]
    right, within = (sum(c[key] for c in cases) for key in ("order", "within"))
    print(
        f"{len(cases)} cases: number of masses right {right}, within {WITHIN:g} standard deviations {within}"
    )
    print(f"identification {np.median(seconds):.1f} s (median), {max(seconds):.1f} s (most)")
    if options.diagnose:
        wrong = sum(bool(c.get("wrong")) for c in cases)
        explained = sum(c.get("verdict") in ("explained", "consistent") for c in cases)
        print(f"explained or consistent {explained}, with a wrong name {wrong}")


if __name__ == "__main__":
    main()
