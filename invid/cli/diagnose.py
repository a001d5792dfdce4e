"""``invid diagnose``: what the simulation gets wrong, the cause, the extended model, the gain."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from invid.api import diagnose, load_model, read_recording
from invid.cli.display import ends_on_interrupt, shown_progress
from invid.cli.identify import parse_masses
from invid.cli.options import BUDGET, Budget, Effects, SpokenLanguage, use_effects
from invid.cli.output import EXIT_NOT_TRUSTWORTHY, EXIT_OK, emit, note
from invid.disk import not_written
from invid.errors import InputError, ModelError
from invid.wording.sentence import say

if TYPE_CHECKING:
    from invid.model.diagnosis_document import Diagnosis

TOLD = ("backlash", "coulomb_friction", "extra_mode", "base_compliance")
"""Causes whose limits are told on the screen; all of them stand in the document and in the report."""


def register(app: typer.Typer) -> None:
    """Adds the command."""

    @app.command("diagnose")
    def diagnose_command(
        context: typer.Context,
        recording: Annotated[
            list[Path],
            typer.Argument(
                metavar="REC.h5", help="The recording, or several of one machine, diagnosed together."
            ),
        ],
        model: Annotated[
            Path | None,
            typer.Option(
                "--model",
                metavar="MODEL.json",
                help="Start here instead of identifying first; of another recording: say what changed since.",
            ),
        ] = None,
        further: Annotated[
            list[Path] | None,
            typer.Option("--with", metavar="REC2.h5", help="The same as one more REC.h5."),
        ] = None,
        masses: Annotated[
            str | None,
            typer.Option(help="Masses of each axis, as 3,3,3; or auto. Default: what the recording says."),
        ] = None,
        output: Annotated[
            Path | None,
            typer.Option("-o", "--output", metavar="DIAGNOSIS.json", help="Where the diagnosis goes."),
        ] = None,
        report: Annotated[
            Path | None, typer.Option("--report", metavar="REPORT.html", help="Where the report goes.")
        ] = None,
        budget: Budget = BUDGET,
        effects: Effects = None,
        against: Annotated[
            Path | None,
            typer.Option(
                "--against",
                metavar="SIM",
                help="A simulator of the machine: MuJoCo XML, URDF, invid model, FMU. Says what is wrong.",
            ),
        ] = None,
        corrected: Annotated[
            Path | None,
            typer.Option("--corrected", metavar="OUT", help="Where the simulator's corrected copy goes."),
        ] = None,
        language: SpokenLanguage = "en",
        as_json: Annotated[bool, typer.Option("--json", help="Print the diagnosis as JSON.")] = False,
    ) -> int:
        """Name what the model gets wrong, with the extended model and the gain on held-out data."""
        from invid.model.diagnosis_document import diagnosis_to_json
        from invid.recording.concatenation import concatenate_recordings

        use_effects(context, effects)
        wanted = parse_masses(masses)
        if model is not None and masses is not None:
            raise InputError(
                "--masses and --model: the model says how many masses there are; give one of the two"
            )
        data = concatenate_recordings([read_recording(p) for p in (*recording, *(further or ()))])
        given = None if model is None else load_model(model)
        try:
            with ends_on_interrupt(), shown_progress("diagnosing") as progress:
                diagnosis = diagnose(
                    data, model=given, masses=wanted, budget=budget, progress=progress, against=against,
                    corrected=corrected,
                )  # fmt: skip
        except ModelError as error:  # an effect that this robot cannot have
            if given is None or not given.effects:
                raise
            raise ModelError(f"{model}: {error}") from None
        document = diagnosis_to_json(diagnosis)
        if output is not None:
            diagnosis.save(output)
            note(
                f"diagnosis written to {output}; it holds the extended model: simulate, export, tune, compare"
            )
        if report is not None:
            from invid.report.data import linear_model_of
            from invid.report.page import render_report

            _write(report, render_report(data, linear_model_of(diagnosis), diagnosis))
            note(f"report written to {report}")
        if as_json:
            for warning in diagnosis.warnings:
                note(f"warning: {warning}")
        seen = [f"report: {report}"] if report is not None else []
        emit(document, "\n".join([diagnosis_text(diagnosis, language), *seen]), as_json=as_json)
        trustworthy = bool(diagnosis.model.fit.get("trustworthy", True))
        return EXIT_OK if trustworthy else EXIT_NOT_TRUSTWORTHY


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise not_written(path, error) from None


def diagnosis_text(diagnosis: Diagnosis, language: str = "en") -> str:
    """The headline, the sentences, then the residuals, the competing causes and the warnings.

    ``language`` is that of the headline.
    """
    from invid.diagnosis.headline import verdict_line
    from invid.planning.separating_experiments import is_measurable

    headline = say(diagnosis.headline, language)
    lines = [headline, ""] if headline else []
    lines += diagnosis.sentences
    lines.append("")
    lines.append(f"verdict: {verdict_line(diagnosis)}")
    lines.append("missing torque, rms on held-out data")
    lines.append(f"  {'axis':<12} {'before':>11} {'after':>11} {'noise':>11}")
    for r in diagnosis.residual:
        floor = "unknown" if r.noise_floor is None else f"{r.noise_floor:.4g}"
        lines.append(f"  {r.axis:<12} {r.before:>11.4g} {r.after:>11.4g} {floor:>11} {r.unit}")
    for f in diagnosis.findings:
        place = " ".join(x for x in (f.effect.axis, f.effect.element, f.effect.other_axis) if x)
        lines.append(f"{f.effect.cause} ({place}), confidence {f.confidence:.2f}")
        if f.consequence is not None:
            means = f"  {str(f.consequence.grade).replace('_', ' ')}"
            means += f": {f.consequence.text}" if f.consequence.text else ""
            lines.append(f"{means} ({f.consequence.reason})")
            if f.consequence.source not in (None, "config"):
                lines.append(f"    by {f.consequence.source}")
        for name, p in f.effect.parameters.items():
            spread = "" if p.std is None else f" ± {p.std:.2g}"
            lines.append(f"  {name:<20} {p.value:.5g}{spread} {p.unit or ''}".rstrip())
        for a in f.alternatives:
            other = " ".join(x for x in (a.axis, a.element, a.other_axis) if x)
            lines.append(f"  not told apart from {a.cause} ({other}), after {a.after:.4g}")
        if f.separating_experiment is not None:
            planned = f.separating_experiment
            lines.append(f"  to separate them: {planned.get('description') or planned.get('text', '')}")
            causes = {*planned.get("separates", ()), *(a.cause for a in f.alternatives)}
            if any(is_measurable(c) for c in causes):
                lines.append(
                    "  (invid measure CONFIG --separate DIAGNOSIS.json -o NEW.h5 runs it; then diagnose with "
                    "--with NEW.h5)"
                )
    told = [r.sentence for r in diagnosis.ruled_out if r.cause in TOLD]
    if told:
        lines += ["ruled out, 95 % sure (every cause: --json, --report)", *(f"  {t}" for t in told)]
    if diagnosis.against is not None:
        lines += ["", *diagnosis.against["sentences"]]
        lines += [f"warning: {w}" for w in diagnosis.against["warnings"]]
    lines += [f"warning: {w}" for w in diagnosis.warnings]
    return "\n".join(lines)
