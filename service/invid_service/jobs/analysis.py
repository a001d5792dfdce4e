"""Make model, diagnosis, report and the numbers of the page's pictures from a job's recording."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

from invid.api import diagnose, identify, screen
from invid.comparison.answers import with_stated_inertia
from invid.config import CellConfig
from invid.errors import InputError, NotIdentifiableError, RecordingError
from invid.identification.stated_inertia import against_stated
from invid.model.diagnosis_document import Diagnosis, Finding, Grade, diagnosis_to_json
from invid.model.document import Model, dump_json, model_from_json, model_to_json, save_text, with_numbers
from invid.model.doubts import doubts_of
from invid.planning.separating_experiments import to_separate
from invid.recording import Recording, read_recording
from invid.recording.still_axes import moving_part
from invid.report.data import figure_data
from invid.report.page import render_report
from invid.tuning.axis_loop import prediction_from_json
from invid.tuning.page import verification_picture, verification_to_json
from invid.tuning.verification import Verdict, verify
from invid.wording.sentence import joined
from invid_service.jobs.progress import AnalysisProgress
from invid_service.jobs.protocol import Job, Read, RunnerLine
from invid_service.precedence import behind_parent

_DIGITS = 5
"""Significant ones of the numbers of pictures; a screen shows four."""
WALL = 2.0
"""By the clock an analysis takes at most so many times its budget of processor time (the contract)."""


def analyse(job: Job, line: RunnerLine, seen: Mapping[str, Any] | None) -> dict[str, Any]:
    """Identify, diagnose and report, write the numbers of the page's pictures, return the summary.

    ``seen`` is what the measurement saw, ``None`` where the recording comes from elsewhere.
    """
    behind_parent()
    tell = AnalysisProgress(line, job.expected_analysis_s, WALL * job.budget_s)
    with tell.told():
        tell.begin("reading the recording")
        # Model and report name the run, not a working folder that is gone when somebody reads them.
        path = job.folder / "recording.h5"
        recording = replace(read_recording(path), source=f"{job.folder.name}/{path.name}")
        _require_axes(recording.axes, job)
        # An uploaded recording may come from a simulated cell too; the drives then wrote it down.
        simulated = job.simulated or bool(recording.attributes.get("simulated", False))
        flag = {"simulated": simulated}
        line.tell(Read(robot=recording.robot, axes=recording.axes, simulated=simulated))
        if job.tuning is not None:
            return _verified(job, recording, tell, seen)
        accepted = None if job.model is None else model_from_json(job.model, source="accepted model")
        if job.mode == "screen" and accepted is not None:
            tell.begin("diagnosing")
            screening = screen(recording, accepted, budget=job.budget_s, progress=tell.weigh)
            if screening.diagnosis is None:
                raise NotIdentifiableError(screening.sentence)
            diagnosis = screening.diagnosis
            model = best = diagnosis.model
        else:
            diagnosis, model = _diagnose_anew(recording, accepted, job, tell, flag)
            best = diagnosis.model
            if not diagnosis.findings:
                # The identification's own numbers, with what the search for causes said of them.
                said = ("verdict", "trustworthy", "doubts", "distrust", "unseen")
                best = replace(model, fit={**model.fit, **{k: best.fit[k] for k in said if k in best.fit}})
        tell.begin("writing the report")
        save_text(job.folder / "model.json", dump_json({**model_to_json(best), **flag}))
        save_text(job.folder / "diagnosis.json", dump_json({**diagnosis_to_json(diagnosis), **flag}))
        started = {"run": job.id, "started by": job.requested_by}
        marked = replace(recording, attributes={**recording.attributes, **flag})
        save_text(job.folder / "report.html", render_report(marked, model, diagnosis, run=started))
        save_text(job.folder / "plots.json", dump_json({**plot_data(recording, model, diagnosis), **flag}))
    said = [] if seen is None else seen["warnings"]
    return {
        "verdict": str(diagnosis.verdict),
        "headline": diagnosis.headline,
        "grade": None if diagnosis.grade is None else str(diagnosis.grade),
        "findings": [summary_of(f) for f in diagnosis.findings],
        "sentences": list(diagnosis.sentences),
        "explained_fraction": diagnosis.explained_fraction,
        "trustworthy": bool(best.fit.get("trustworthy", True)),
        "distrust": [d.to_json() for d in doubts_of(best.fit)],
        "warnings": list(dict.fromkeys([*said, *model.warnings, *diagnosis.warnings])),
        "separating": separating(diagnosis, job),
        "analysis_s": round(tell.elapsed_s, 1),
    }


def _verified(
    job: Job, recording: Recording, tell: AnalysisProgress, seen: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Compare the loops that were measured with what their tuning predicted; return the summary."""
    tell.begin("diagnosing")
    found = verify(*prediction_from_json(job.tuning, "tuning.json"), recording)
    document = verification_to_json(found)
    save_text(job.folder / "verification.json", dump_json({**document, "simulated": job.simulated}))
    save_text(job.folder / "verification.svg", verification_picture(found))
    grades = {Verdict.WORSE: Grade.ACT, Verdict.OTHER: Grade.WATCH, Verdict.CANNOT_TELL: Grade.WATCH}
    return {
        "verdict": str(found.verdict),
        "headline": joined(document["sentences"], " "),
        "grade": str(grades.get(found.verdict, Grade.AS_EXPECTED)),
        "findings": [],
        "sentences": document["sentences"],
        "explained_fraction": None,
        "trustworthy": found.verdict is not Verdict.CANNOT_TELL,
        "distrust": [],
        "warnings": [] if seen is None else seen["warnings"],
        "separating": None,
        "analysis_s": round(tell.elapsed_s, 1),
    }


def _diagnose_anew(
    recording: Recording, accepted: Model | None, job: Job, tell: AnalysisProgress, flag: Mapping[str, bool]
) -> tuple[Diagnosis, Model]:
    """Return the diagnosis of a full record and the model that was identified for it, which is saved at
    once.
    """
    tell.begin("identifying")
    budget = 0.3 * job.budget_s
    model = identify(recording, budget=budget, progress=tell.weigh)
    save_text(job.folder / "model.json", dump_json({**model_to_json(model), **flag}))
    tell.begin("diagnosing")
    diagnosis = diagnose(recording, model=model, budget=job.budget_s - budget, progress=tell.weigh)
    return with_stated_inertia(diagnosis, recording, accepted), against_stated(model, recording, accepted)


def separating(diagnosis: Diagnosis, job: Job) -> dict[str, Any] | None:
    """Return what would tell the alternatives apart on this cell; ``None`` where nothing is to be, or
    can be.
    """
    if job.config is None or not diagnosis.findings:
        return None
    try:
        found = to_separate(diagnosis_to_json(diagnosis), CellConfig.model_validate(job.config))
    except InputError:
        return None
    return {"finding": found.finding, "text": joined(found.sentences, " ")}


def _require_axes(axes: tuple[str, ...], job: Job) -> None:
    """Raise RecordingError where an uploaded recording is not of the cell whose history it is to join."""
    if job.kind != "analyse" or job.config is None:
        return
    names = [a["name"] for a in job.config["axes"]]
    if list(axes) != names:
        raise RecordingError(
            f"recording.h5: it has the axes {', '.join(axes)}, the cell has {', '.join(names)}",
            way_out="upload it without a cell, or name the cell that it is of",
        )


def summary_of(finding: Finding) -> dict[str, Any]:
    """Return one finding as a list shows it: what, where, how serious."""
    means = finding.consequence
    return {
        "cause": finding.effect.cause,
        "axis": finding.effect.axis,
        "element": finding.effect.element,
        "other_axis": finding.effect.other_axis,
        "sentence": finding.sentence,
        "consequence": None if means is None else asdict(means),
    }


def plot_data(recording: Recording, model: Model, diagnosis: Diagnosis) -> dict[str, Any]:
    """Return ``figure_data`` rounded, no NaN: page and report show the same."""
    recording, _ = moving_part(recording, diagnosis.model.axes)
    document: dict[str, Any] = with_numbers(figure_data(recording, model, diagnosis), _rounded)
    return {"axes": list(recording.axes), **document}


def _rounded(value: float) -> float | None:
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None
