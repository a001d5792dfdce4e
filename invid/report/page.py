"""Render the report: one HTML file that needs nothing else; the sentence first, then the pictures."""

from __future__ import annotations

import hashlib
import json
import math
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from invid.diagnosis.headline import verdict_line
from invid.model.diagnosis_document import Diagnosis, Verdict
from invid.model.document import EffectTerm, Model, linear_parameters
from invid.recording.model import Recording
from invid.recording.still_axes import moving_part
from invid.report.branch_drawing import branch_drawing
from invid.report.data import figure_data
from invid.report.figures import draw
from invid.report.labels import printable
from invid.wording.figures import differing_number

MOST_SAID = 3
"""Sentences, and warnings, before the pictures; more is folded (a convention)."""
HEADLINE = {
    Verdict.CONSISTENT: "The model explains this measurement down to its noise.",
    Verdict.EXPLAINED: "The cause is named, and with it the model is down to the noise.",
    Verdict.PARTLY_EXPLAINED: "A cause is named, but something is left over.",
    Verdict.UNEXPLAINED: "Something is missing from the model, and no known cause explains it.",
}


def render_report(
    recording: Recording,
    model: Model,
    diagnosis: Diagnosis | None = None,
    *,
    run: Mapping[str, str] | None = None,
) -> str:
    """Self-contained HTML: no network, no scripts; everything that comes from data is escaped.

    ``model`` is the linear model before the diagnosis. Pictures that the data cannot carry are
    replaced by the reason. ``run`` is what is known of the run beyond its data (who started it, say): rows
    before all others of where the report comes from, and on the first line.
    """
    part, _ = moving_part(recording, model.axes)
    data = figure_data(part, model, diagnosis)
    drawn = draw(data)
    first = [name for name in drawn if name in ("residual", "forces") or name.startswith("cause-")]
    shown = model if diagnosis is None else diagnosis.model
    findings = () if diagnosis is None else diagnosis.findings
    lost = None if diagnosis is None else diagnosis.unexplained
    # Where it is comes before how much.
    pictures = {"branches": branch_drawing(shown, findings, lost)}
    pictures |= {name: drawn[name] for name in first}
    pictures |= {name: picture for name, picture in drawn.items() if name not in pictures}
    environment = Environment(
        loader=PackageLoader("invid.report", ""), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters["clean"] = lambda text: printable(str(text), 2000)
    # The configuration is evidence, kept whole; what an upload brings is bounded all the same.
    environment.filters["whole"] = lambda text: printable(str(text), 200_000)
    return environment.get_template("report.html.j2").render(
        recording=recording,
        diagnosis=diagnosis,
        headline=_headline(model, diagnosis),
        sentences=_sentences(diagnosis),
        pictures=pictures,
        data=data,
        notes=data["notes"],
        parameters=_parameters(shown),
        effects=[_effect(e) for e in shown.effects],
        findings=[_finding(f) for f in findings],
        verdict=None if diagnosis is None else verdict_line(diagnosis),
        folded=_folded(pictures),
        MOST_SAID=MOST_SAID,
        warnings=list(dict.fromkeys([*model.warnings, *(() if diagnosis is None else diagnosis.warnings)])),
        run=dict(run or {}),
        facts=[*(run or {}).items(), *_facts(recording, model)],
        provenance=_flat(shown.provenance),
        fit=_flat(shown.fit),
        details={} if diagnosis is None else _flat(diagnosis.details),
        simulated=bool(recording.attributes.get("simulated", False)),
    )


def _folded(pictures: Mapping[str, str]) -> list[tuple[str, list[str]]]:
    """Return what is opened by who wants to see it: titles, each with the names of its pictures."""
    kinds = (
        ("What is missing, over what", ("forces", "cause-", "missing-torque")),
        ("Motion per torque, over frequency", ("frf-",)),
    )
    rows = [(title, [n for n in pictures if n.startswith(begins)]) for title, begins in kinds]
    return [(title, names) for title, names in rows if names]


def _headline(model: Model, diagnosis: Diagnosis | None) -> str:
    if diagnosis is None:
        spread = np.concatenate([*model.std.masses, *model.std.springs])
        if not np.isfinite(spread).all():
            return "An elastic model of this robot, but this measurement cannot tell all of it."
        return "The elastic model of this robot, identified from the measurement."
    return printable(diagnosis.headline, 600) or HEADLINE[diagnosis.verdict]


def _sentences(diagnosis: Diagnosis | None) -> list[str]:
    if diagnosis is None:
        return []
    said = list(diagnosis.sentences)
    if not said:
        said = [f.sentence for f in diagnosis.findings if f.sentence]
    if diagnosis.unexplained is not None and diagnosis.unexplained.sentence not in said:
        said.append(diagnosis.unexplained.sentence)
    return said


_ONE_OF_A_KIND = {"ground_spring": "spring to ground", "coupling": "coupling"}


# --- tables -----------------------------------------------------------------------------------------
def _number(value: float, std: float | None) -> tuple[str, str, str]:
    """Value, std and relative std as text; a dash where the data cannot tell."""
    if std is None or not math.isfinite(std):
        return f"{value:.5g}", "cannot tell", ""
    relative = f"{100 * std / abs(value):.2g} %" if value else ""
    return differing_number(value, std), f"{std:.2g}", relative


def _parameters(model: Model) -> list[dict[str, str]]:
    rows = []
    for p in linear_parameters(model):
        value, std, relative = _number(p.value, p.std)
        name = f"{p.kind} {p.number}" if p.number else _ONE_OF_A_KIND[p.kind]
        rows.append(
            {
                "axis": "–".join(p.axes),
                "name": name,
                "value": value,
                "std": std,
                "relative": relative,
                "unit": p.unit,
            }
        )
    return rows


def _effect(term: EffectTerm) -> dict[str, Any]:
    return {
        "cause": term.cause.replace("_", " "),
        "axis": term.axis + (f" – {term.other_axis}" if term.other_axis else ""),
        "element": term.element or "",
        "parameters": [
            {"name": name.replace("_", " "), "shown": _number(e.value, e.std), "unit": e.unit or ""}
            for name, e in term.parameters.items()
        ],
    }


def _finding(f: Any) -> dict[str, Any]:
    return {
        **_effect(f.effect),
        "grade": "" if f.consequence is None else str(f.consequence.grade).replace("_", " "),
        "means": "" if f.consequence is None else f"{f.consequence.text} ({f.consequence.reason})",
        "confidence": f"{100 * f.confidence:.1f} %",
        "before": f"{f.before:.3g}",
        "after": f"{f.after:.3g}",
        "fraction": f"{100 * f.fraction:.0f} %",
        "alternatives": [
            f"{', '.join(x for x in (a.cause.replace('_', ' '), a.axis, a.element, a.other_axis) if x)} "
            f"(would leave {a.after:.3g})"
            for a in f.alternatives
        ],
        "separating": None if f.separating_experiment is None else _flat(f.separating_experiment),
    }


def _facts(recording: Recording, model: Model) -> list[tuple[str, str]]:
    seconds = sum(e.duration for e in recording.experiments)
    facts = [
        ("robot", recording.robot),
        ("recorded", recording.created),
        ("axes", ", ".join(recording.axes)),
        ("experiments", f"{len(recording.experiments)}, {seconds:.0f} s in all"),
        ("method", model.method),
        ("source", recording.source),
        ("outcome", str(recording.outcome) if recording.outcome else "not stated"),
        ("invid", version("invid")),
        ("Python", platform.python_version()),
        *((name, version(name)) for name in ("numpy", "scipy", "numba")),
        ("SHA-256 of the samples", _checksum(recording)),
    ]
    return [(name, str(value)) for name, value in facts]


def _checksum(recording: Recording) -> str:
    """Return the checksum of time, position and torque of every experiment, as float64 in order."""
    digest = hashlib.sha256()
    for e in recording.experiments:
        for array in (e.time, e.position, e.torque):
            digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return digest.hexdigest()


def _flat(document: Mapping[str, Any] | Sequence[Any], most: int = 40) -> list[tuple[str, str]]:
    """Rows of a free-form document, long values cut."""
    items = document.items() if isinstance(document, Mapping) else enumerate(document)
    rows = []
    for name, value in items:
        shown = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
        rows.append((str(name), shown if len(shown) <= 400 else shown[:399] + "…"))
    return rows[:most]
