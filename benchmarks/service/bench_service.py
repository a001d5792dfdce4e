"""The change test of the service.

    python benchmarks/service/bench_service.py [--changes 200] [--first-seed 0] [--keep DIR]

An unchanged simulated cell, each start with its own noise: measured, identified and diagnosed as the runner
does it, compared with the run before by what the service uses (``invid.compare`` with the cell's history).
Then the same starts with one parameter changed by three standard deviations of repetition. ``--keep DIR``
keeps the models there and goes on where an earlier call ended.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy import special

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "system"))
from service_process import SMALL_CELL

from invid.comparison.changes import Comparison, Status
from invid.comparison.compare import compare
from invid.model.document import Model, model_from_json, model_to_json, parameter_vector

ROOT = Path(__file__).parents[2]
HISTORY = 40
EVERY = 4
"""Of the starts, those that are tried with a change too."""
SIDES = ((1, 1), (2, 1), (8, 1), (5, 3), (8, 3))
"""Runs that the old and the new side may be the mean of."""
PROMISED = 0.02
"""False alarms over all parameters."""


def measured(seed: int, folder: Path) -> Model:
    """One whole run of the small cell in this process, as the runner does it; kept in ``folder``."""
    from invid.model.document import load_model

    kept = folder / f"{seed}.json"
    if not kept.exists():
        from invid.config import CellConfig
        from invid.diagnosis.diagnose import diagnose
        from invid.identification.identify import identify
        from invid.model.document import dump_json, model_to_json, save_text
        from invid.recording import read_recording
        from invid_drivers.measurement import measure_to_file

        document = yaml.safe_load(SMALL_CELL)
        document["simulation"]["seed"] = seed
        path = folder / f"{seed}.h5"
        measure_to_file(CellConfig.model_validate(document), path)
        recording = read_recording(path)
        model = identify(recording)
        diagnosis = diagnose(recording, model=model)
        best = diagnosis.model if diagnosis.findings else model
        save_text(kept, dump_json(model_to_json(best)))
        path.unlink()
    return load_model(kept)


def verdict(
    old: Model, new: list[Model], earlier: list[Model], before: list[Model]
) -> tuple[set[str], set[str], Comparison]:
    """Names called changed, and names of which one or another changed; as the service asks."""
    result = compare(old, new[-1], history=[*earlier, *new], before=before, after=new[:-1])
    everything = result.parameters + result.effects
    return (
        {c.name for c in everything if c.status is Status.CHANGED},
        {c.name for c in everything if c.rivals},
        result,
    )


def shifted(model: Model, name: str, by: float) -> Model:
    """The same estimate of a robot whose ``name`` is larger: for small changes an estimate moves along."""
    document = model_to_json(model)
    _axis, kind, place = name.split(".")
    column = {"mass": "masses", "spring": "springs", "damper": "dampers"}[kind]
    document["branches"][0][column][int(place) - 1]["value"] += by
    return model_from_json(document)


def changes(starts: int, keep: Path | None, first: int = 0) -> bool:
    """False alarms on an unchanged cell, and one parameter changed by three deviations of repetition."""
    with tempfile.TemporaryDirectory() as name:
        folder = keep or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        models = [measured(seed, folder) for seed in range(first, first + starts + 1)]
    names, _ = parameter_vector(models[0].chains)
    values = np.array([parameter_vector(m.chains)[1] for m in models])
    repetition = values.std(axis=0, ddof=1)
    fitted = np.sqrt(np.mean([np.diag(m.covariance) for m in models if m.covariance is not None], axis=0))
    covariance = np.mean([m.covariance for m in models if m.covariance is not None], axis=0)
    sharp = 1 / np.sqrt(np.diag(np.linalg.inv(covariance))) / np.sqrt(np.diag(covariance))
    print(
        f"changes: scatter of {len(models)} runs over what their fits say: "
        f"{np.array2string(repetition / fitted, precision=2)}"
    )
    print("each: found (named alone), from how many deviations on it says that it would be found in 90 %,")
    print("and the share that no test with 2 % false alarms can exceed")
    print(
        "| baseline runs | new runs | starts | false alarms | averaged |", *(f" {n} |" for n in names), sep=""
    )
    print("| --- | --- | --- | --- | --- |", " --- |" * len(names), sep="")
    kept = True
    for baseline, fresh in SIDES:
        alarms, found, exact, wrong, mean, seen = power(models, names, repetition, baseline, fresh)
        starts, tried = len(models) - baseline - fresh + 1, len(seen)
        kept = kept and alarms <= PROMISED * starts
        most = attainable(sharp, baseline, fresh)
        cells = (
            f" {100 * found[n] / tried:.0f} % ({100 * exact[n] / tried:.0f} %), from "
            f"{np.median([s[j] for s in seen]) / repetition[j]:.1f}, at most {100 * most[j]:.0f} % |"
            for j, n in enumerate(names)
        )
        print(
            f"| {baseline} | {fresh} | {starts} | {alarms} ({100 * alarms / starts:.1f} %) | {mean:.1f} |",
            *cells,
            sep="",
            flush=True,
        )
        print(f"another one called changed: {wrong} of {tried * len(names)}", file=sys.stderr)
    print("| parameter | repetition | alone it is known to |")
    print("| --- | --- | --- |")
    for j, parameter in enumerate(names):
        relative = 100 * repetition[j] / abs(values[:, j].mean())
        print(f"| {parameter} | {relative:.3f} % | {sharp[j]:.2f} std |")
    return kept


def attainable(sharp: Any, baseline: int, fresh: int) -> Any:
    """Power of the best test there is for one parameter, were it told which and how noisy (Neyman-Pearson):
    a change of three deviations of repetition stands at 3 / (sharp √(1/baseline + 1/fresh)) of its own."""
    away = 3.0 / (np.asarray(sharp) * np.sqrt(1 / baseline + 1 / fresh))
    return special.ndtr(away + special.ndtri(PROMISED / 2))


def power(
    models: list[Model], names: tuple[str, ...], repetition: Any, baseline: int, fresh: int
) -> tuple[int, dict[str, int], dict[str, int], int, float, list[list[float]]]:
    """One row: alarms without a change, then found and named with each parameter changed."""
    alarms, wrong = 0, 0
    exact, found = dict.fromkeys(names, 0), dict.fromkeys(names, 0)
    averaged: list[int] = []
    seen: list[list[float]] = []
    for k in range(baseline, len(models) - fresh + 1):
        earlier, new = models[max(0, k - HISTORY) : k], models[k : k + fresh]
        before = models[k - baseline : k - 1]
        named, either, result = verdict(models[k - 1], new, earlier, before)
        alarms += bool(named or either)
        averaged.append(result.runs[0])
        if (k - baseline) % EVERY:
            continue
        seen.append([(c.detectable or np.nan) * c.scale for c in result.parameters])
        for j, parameter in enumerate(names):
            moved = [shifted(m, parameter, 3.0 * float(repetition[j])) for m in new]
            named, either, _ = verdict(models[k - 1], moved, earlier, before)
            exact[parameter] += named == {parameter}
            found[parameter] += parameter in named | either
            wrong += bool(named - {parameter})
    return alarms, found, exact, wrong, float(np.mean(averaged)), seen


def main() -> int:
    """Run the campaign; the exit status is 1 where false alarms are more than promised."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--changes", type=int, default=200)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=None)
    given = parser.parse_args()
    return int(not changes(given.changes, given.keep, given.first_seed))


if __name__ == "__main__":
    sys.exit(main())
