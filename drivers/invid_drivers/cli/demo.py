"""``invid demo``: measure, identify and diagnose a simulated three-axis cell."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer

from invid.cli.output import EXIT_NOT_TRUSTWORTHY, EXIT_OK, emit, note
from invid.config import load_config
from invid.diagnosis.diagnose import diagnose
from invid.identification.identify import identify
from invid.model.chains import CoupledChains
from invid.model.diagnosis_document import diagnosis_to_json
from invid.model.document import (
    Model,
    dump_json,
    numbers_by_name,
    parameter_vector,
    save_model,
    save_text,
    stds_by_name,
    units,
)
from invid.recording import read_recording
from invid.report.page import render_report
from invid_drivers.cli.measure import ProgressLine
from invid_drivers.measurement import measure_to_file
from invid_drivers.simulated import CASE_STUDY, truth


@dataclass(frozen=True)
class Row:
    """One parameter: what the simulated plant has, what was identified."""

    name: str
    unit: str
    truth: float
    estimate: float
    std: float

    @property
    def error_percent(self) -> float:
        """Relative error of the estimate [%]."""
        return 100.0 * (self.estimate - self.truth) / self.truth if self.truth else float("nan")

    @property
    def sigmas(self) -> float:
        """Error in standard deviations; NaN where the data cannot tell."""
        return (self.estimate - self.truth) / self.std if self.std > 0 else float("nan")

    def to_json(self) -> dict[str, Any]:
        """Plain values; ``null`` where the data cannot tell."""
        known = np.isfinite(self.std)
        return {
            "parameter": self.name,
            "unit": self.unit,
            "truth": self.truth,
            "estimate": self.estimate,
            "std": float(self.std) if known else None,
            "error_percent": self.error_percent if np.isfinite(self.error_percent) else None,
            "sigmas": float(self.sigmas) if np.isfinite(self.sigmas) else None,
        }


def truth_table(plant: CoupledChains, model: Model) -> list[Row]:
    """Masses, springs and couplings of the plant beside the model's, with standard deviations."""
    found, std, unit = numbers_by_name(model.axes, model.chains), stds_by_name(model), units(model.linear)
    unit_of = {"mass": unit["mass"], "spring": unit["stiffness"], "coupling": unit["mass"]}
    return [
        Row(name.replace(".", " "), unit_of[kind], float(value), found[name], std[name])
        for name, value in zip(*parameter_vector(plant), strict=True)
        if (kind := name.split(".")[1]) in unit_of
    ]


def format_table(rows: list[Row]) -> str:
    """Truth beside estimate as text."""
    lines = [
        f"{'parameter':<16} {'truth':>10} {'estimate':>12} {'± std':>10} {'error':>9} {'error/std':>9}  unit"
    ]
    for r in rows:
        lines.append(
            f"{r.name:<16} {r.truth:>10.5g} {r.estimate:>12.6g} {r.std:>10.2g} "
            f"{r.error_percent:>+8.3f}% {r.sigmas:>+9.1f}  {r.unit}"
        )
    worst = max(abs(r.error_percent) for r in rows)
    inside = sum(abs(r.sigmas) <= 3 for r in rows)
    lines.append(f"worst error {worst:.3f} %; truth inside ±3 std for {inside} of {len(rows)} parameters")
    return "\n".join(lines)


def run_demo(out: Path) -> tuple[dict[str, Any], str, int]:
    """Measure, identify, diagnose, report; the JSON document, the text and the exit status."""
    started = time.monotonic()
    config = load_config(CASE_STUDY)
    out.mkdir(parents=True, exist_ok=True)
    paths = {
        "recording": out / "recording.h5",
        "model": out / "model.json",
        "diagnosis": out / "diagnosis.json",
        "report": out / "report.html",
    }
    note(f"invid demo: {config.robot}; simulated drives on the virtual CAN bus, nothing moves")
    measured = measure_to_file(config, paths["recording"], progress=ProgressLine())
    note(f"measured {measured.duration_s:.0f} s of robot time in {time.monotonic() - started:.1f} s")
    recording = read_recording(paths["recording"])
    model = identify(recording)
    save_model(model, paths["model"])
    note(f"identified after {time.monotonic() - started:.1f} s")
    diagnosis = diagnose(recording, model=model)
    save_text(paths["diagnosis"], dump_json(diagnosis_to_json(diagnosis)))
    save_text(paths["report"], render_report(recording, model, diagnosis))
    rows = truth_table(truth(config), model)
    seconds = time.monotonic() - started
    warnings = list(dict.fromkeys([*model.warnings, *diagnosis.warnings]))
    document = {
        "simulated": True,
        "robot": config.robot,
        "files": {name: str(path) for name, path in paths.items()},
        "parameters": [r.to_json() for r in rows],
        "verdict": str(diagnosis.verdict),
        "headline": diagnosis.headline,
        "sentences": list(diagnosis.sentences),
        "warnings": warnings,
        "robot_time_s": measured.duration_s,
        "wall_time_s": seconds,
    }
    text = "\n".join(
        [
            format_table(rows),
            "",
            f"diagnosis: {diagnosis.verdict}",
            f"  {diagnosis.headline}",
            *(f"  {s}" for s in diagnosis.sentences),
            *(f"warning: {w}" for w in warnings),
            "",
            f"{measured.duration_s:.0f} s of robot time, {seconds:.1f} s in all. Written:",
            *(f"  {path}" for path in paths.values()),
        ]
    )
    untrusted = any(not np.isfinite(r.std) for r in rows)
    return document, text, EXIT_NOT_TRUSTWORTHY if untrusted else EXIT_OK


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    def demo(
        out: Path = typer.Option(Path("invid-demo"), "--out", help="Folder for the results."),
        as_json: bool = typer.Option(False, "--json", help="One JSON document on stdout."),
    ) -> int:
        """Measure, identify and diagnose a simulated three-axis cell; truth beside estimate."""
        document, text, status = run_demo(out)
        emit(document, text, as_json=as_json)
        return status
