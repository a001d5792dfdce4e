"""``invid identify``: recording to masses, springs, dampers and couplings with their uncertainty."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from invid.api import identify, read_recording
from invid.cli.display import ends_on_interrupt, shown_progress
from invid.cli.options import BUDGET, Budget, Effects, use_effects
from invid.cli.output import EXIT_NOT_TRUSTWORTHY, EXIT_OK, emit, note
from invid.errors import InputError, NotIdentifiableError

if TYPE_CHECKING:
    from invid.api import Masses, Method
    from invid.model.document import Model
    from invid.recording.model import Recording


def register(app: typer.Typer) -> None:
    """Adds the command."""

    @app.command("identify")
    def identify_command(
        context: typer.Context,
        recording: Annotated[Path, typer.Argument(metavar="REC.h5", help="The recording.")],
        output: Annotated[
            Path | None, typer.Option("-o", "--output", metavar="MODEL.json", help="Where the model goes.")
        ] = None,
        masses: Annotated[
            str | None,
            typer.Option(help="Masses of each axis, as 3,3,3; or auto. Default: what the recording says."),
        ] = None,
        method: Annotated[
            str, typer.Option(help="refined, or paper: its inverse on measured resonances, beside refined.")
        ] = "refined",
        budget: Budget = BUDGET,
        effects: Effects = None,
        as_json: Annotated[bool, typer.Option("--json", help="Print the model as JSON.")] = False,
    ) -> int:
        """Masses, springs, dampers and inertia couplings from a recording, with their uncertainty."""
        from invid.model.document import model_to_json

        use_effects(context, effects)
        wanted = parse_masses(masses)
        data = read_recording(recording)
        try:
            with ends_on_interrupt(), shown_progress("identifying") as progress:
                model = identify(
                    data,
                    masses=wanted,
                    method=cast("Method", method),
                    budget=budget,
                    progress=progress,
                )
        except NotIdentifiableError as error:
            if not as_json:
                raise
            note(f"invid: {error}")
            emit(no_model_to_json(data, method, str(error)), "", as_json=True)
            return error.exit_code
        if output is not None:
            model.save(output)
            note(f"model written to {output}")
        if as_json:
            for warning in model.warnings:
                note(f"warning: {warning}")
        emit(model_to_json(model), model_text(model), as_json=as_json)
        return EXIT_OK if model.fit.get("trustworthy", True) else EXIT_NOT_TRUSTWORTHY


def no_model_to_json(recording: Recording, method: str, reason: str) -> dict[str, Any]:
    """What --json prints where the data carry no model: the model's keys, no branches, the reason.

    Such a document goes to stdout only, never to the file of ``-o``: no command could read it, and it
    would replace a model that may be there.
    """
    from invid.model.document import FORMAT, FORMAT_VERSION, units

    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "robot": recording.robot,
        "method": method,
        "units": units(recording.position_unit == "m"),
        "branches": [],
        "couplings": [],
        "effects": [],
        "warnings": [reason],
        "fit": {"trustworthy": False},
        "provenance": {},
    }


def parse_masses(text: str | None) -> Masses:
    """ "3,3,3" → (3, 3, 3); "auto" as it is; InputError otherwise."""
    if text is None:
        return None
    if text == "auto":
        return "auto"
    try:
        return tuple(int(part) for part in text.split(","))
    except ValueError:
        raise InputError(
            f"--masses {text}: give whole numbers separated by commas, one an axis, as 3,3,3, or auto"
        ) from None


def model_text(model: Model) -> str:
    """The model as a table for a person."""
    from invid.model.document import linear_parameters

    beside = model.fit.get("refined", {})
    heading = f"{model.robot}: {model.chains.branches} axes, method {model.method}"
    lines = [heading + (", on the right the estimate by maximum likelihood" if beside else "")]
    for p in linear_parameters(model):
        kind = "ground" if p.kind == "ground_spring" else p.kind
        row = _row(f"{'-'.join(p.axes)} {kind} {p.number or ''}", p.value, p.std, p.unit)
        estimate = beside.get(".".join(filter(None, ("-".join(p.axes), p.kind, str(p.number or "")))))
        lines.append(row if estimate is None else f"{row:<72}{estimate:.5g}")
    for effect in model.effects:
        for estimate in effect.parameters.values():
            label = (
                f"{effect.axis} {effect.cause.split('_')[0]} {(effect.element or '').removeprefix('mass ')}"
            )
            std = float("nan") if estimate.std is None else estimate.std
            lines.append(_row(label, estimate.value, std, estimate.unit or ""))
    if "chi2" in model.fit:
        lines.append(
            f"χ²/ν {model.fit['chi2'] / max(model.fit['dof'], 1):.2f} "
            f"(against sensor noise alone {model.fit['noise_chi2_per_dof']:.3g}), "
            f"band {model.fit['band_hz'][0]:.3g} … {model.fit['band_hz'][1]:.3g} Hz"
        )
    lines += [f"warning: {w}" for w in model.warnings]
    if not model.fit.get("trustworthy", True):
        lines.append("not trustworthy: see the warnings")
    return "\n".join(lines)


def _row(name: str, value: float, error: float, unit: str) -> str:
    if error != error:
        return f"  {name:<18} {value:>12.5g}   not known       {unit}"
    relative = f"({100 * error / abs(value):.2g} %)" if value else ""
    return f"  {name:<18} {value:>12.5g} ± {error:<9.2g} {relative:<9} {unit}"
