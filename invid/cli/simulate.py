"""``invid simulate``: the model's answer to the recorded excitation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from invid.api import load_model, read_recording, simulate, write_recording
from invid.cli.options import Effects, use_effects
from invid.cli.output import EXIT_NOT_TRUSTWORTHY, EXIT_OK, emit, note

if TYPE_CHECKING:
    from invid.recording.model import Recording

_USELESS = 1.0  # an error as large as the motion itself: the model predicts nothing


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command("simulate")
    def _simulate(
        context: typer.Context,
        model: Path = typer.Argument(
            ..., metavar="MODEL.json", help="Model, or a diagnosis: the extended one."
        ),
        recording: Path = typer.Argument(..., metavar="REC.h5", help="Recording whose torques drive it."),
        output: Path = typer.Option(..., "-o", "--output", metavar="SIM.h5", help="Simulated recording."),
        effects: Effects = None,
        as_json: bool = typer.Option(False, "--json", help="Print one JSON document."),
    ) -> int:
        """Simulate a model's answer to a recorded excitation, effects included."""
        use_effects(context, effects)
        loaded = load_model(model)
        measured = read_recording(recording)
        note(f"simulating {len(measured.experiments)} experiments of {measured.axis_count} axes …")
        answer = simulate(loaded, measured)
        write_recording(answer, output)
        document = summary(measured, answer, str(output))
        emit(document, _text(document), as_json=as_json)
        return EXIT_NOT_TRUSTWORTHY if document["warnings"] else EXIT_OK


def summary(measured: Recording, answer: Recording, output: str) -> dict[str, Any]:
    """Position error of every axis and experiment, relative to the motion about its mean."""
    import numpy as np

    experiments, warnings = [], []
    for before, after in zip(measured.experiments, answer.experiments, strict=True):
        difference = after.position - before.position
        spread = np.sqrt(np.mean((before.position - before.position.mean(axis=0)) ** 2, axis=0))
        error = np.sqrt(np.mean(difference**2, axis=0))
        experiments.append(
            {
                "key": before.key,
                "role": str(before.role),
                "position_error": [
                    {
                        "axis": axis,
                        "rms": float(e),
                        "relative": float(e / s) if s > 0 else None,
                        "unit": measured.position_unit,
                    }
                    for axis, e, s in zip(measured.axes, error, spread, strict=True)
                ],
            }
        )
        for axis, e, s in zip(measured.axes, error, spread, strict=True):
            if e > _USELESS * s > 0:
                warnings.append(
                    f"experiment {before.key}, axis {axis}: the simulated motion is off by {e / s:.3g} times "
                    "the measured motion; the model does not describe this record (invid diagnose says what "
                    "is missing)"
                )
    return {"output": output, "robot": measured.robot, "experiments": experiments, "warnings": warnings}


def _text(document: dict[str, Any]) -> str:
    lines = [f"simulated recording: {document['output']}", "position error (rms, of the motion):"]
    for experiment in document["experiments"]:
        errors = ", ".join(
            f"{e['axis']} {e['rms']:.3g} {e['unit']}"
            + ("" if e["relative"] is None else f" ({100 * e['relative']:.3g} %)")
            for e in experiment["position_error"]
        )
        lines.append(f"  {experiment['key']} ({experiment['role']}): {errors}")
    lines += [f"warning: {w}" for w in document["warnings"]]
    return "\n".join(lines)
