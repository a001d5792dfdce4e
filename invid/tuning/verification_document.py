"""A verification as a document, in a sentence an axis, and as a picture: measured beside predicted."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Canvas

from invid.report.figures import plain_hz
from invid.report.labels import label
from invid.report.style import AFTER, BEFORE, INK, svg
from invid.tuning.document import finite
from invid.tuning.verification import AxisVerification, Verification
from invid.wording.statement import ENGLISH, LANGUAGES, Figure, Statement, say_sentence

FORMAT = "invid-verification"
_FIGURES = ("sensitivity", "gain_margin", "phase_margin", "ripple", "following", "settling", "wander")


def verification_to_json(found: Verification) -> dict[str, Any]:
    """The ``invid-verification`` document."""
    return finite(
        {
            "format": FORMAT,
            "format_version": 1,
            "robot": found.robot,
            "verdict": str(found.verdict),
            "sentences": {lang: [sentence(a, lang) for a in found.axes] for lang in LANGUAGES},
            "axes": [_axis_to_json(a) for a in found.axes],
        }
    )


def _axis_to_json(a: AxisVerification) -> dict[str, Any]:
    loop, foretold = 1.0 / a.measured - 1.0, 1.0 / a.predicted - 1.0
    return {
        "axis": a.axis,
        "verdict": str(a.verdict),
        "worst_at_hz": a.worst_at,
        "read_late_s": a.late,
        "rated_torque": a.rated,
        "unit": a.unit,
        **{k: asdict(getattr(a, k)) for k in _FIGURES},
        "response": {
            "frequency_hz": a.frequency.tolist(),
            "sensitivity": {
                "measured": np.abs(a.measured).tolist(),
                "std": a.std.tolist(),
                "predicted": np.abs(a.predicted).tolist(),
                "low": a.low.tolist(),
                "high": a.high.tolist(),
            },
            "loop": {
                side: {"gain": np.abs(x).tolist(), "phase_deg": _phase(x).tolist()}
                for side, x in (("measured", loop), ("predicted", foretold))
            },
        },
    }


def _phase(loop: Any) -> Any:
    return np.degrees(np.angle(-loop)) - 180.0


def sentence(a: AxisVerification, language: str = ENGLISH) -> str:
    """One axis: verdict, peak of sensitivity, phase margin and following error as measured and predicted,
    ripple, the undo where the values stand on what was not found."""
    peak, phase = a.sensitivity, a.phase_margin
    parts = [
        Statement(
            "verify.axis",
            {
                "axis": a.axis,
                "verdict": Statement(f"verify.{a.verdict}"),
                "peak": Figure(f"{peak.measured:.2f} ± {peak.std:.2f}"),
                "foretold": Figure(f"{peak.low:.2f} … {peak.high:.2f}"),
                "phase": Figure(f"{phase.measured:.0f}"),
                "phases": Figure(f"{phase.low:.0f} … {phase.high:.0f}"),
            },
        )
    ]
    if a.verdict.asks_for_undo:
        parts.append(Statement("verify.at", {"frequency": Figure(f"{a.worst_at:.1f}")}))
    share = 100.0 * a.ripple.measured / a.rated
    if math.isfinite(share):
        parts.append(Statement("verify.ripple", {"share": Figure(f"{share:.2f}")}))
    missed, wander = Figure(f"{1e3 * a.following.measured:.2g}"), Figure(f"{1e3 * a.wander.measured:.2g}")
    foretold = Figure(f"{1e3 * a.following.low:.2g} … {1e3 * a.following.high:.2g}")
    parts.append(Statement("verify.move", {"error": missed, "foretold": foretold, "unit": f"m{a.unit}"}))
    if a.wander.measured > a.following.high:
        parts.append(Statement("verify.wander", {"error": wander, "unit": f"m{a.unit}"}))
    if a.verdict.asks_for_undo:
        parts.append(Statement("verify.undo"))
    return say_sentence(parts, language)


def verification_picture(found: Verification) -> str:
    """SVG: a row an axis with |S|, and gain and phase of its loop, measured points on the predicted line."""

    def fill(canvas: Canvas) -> None:
        rows = canvas.subplots(len(found.axes), 3, squeeze=False)
        canvas.subplots_adjust(wspace=0.35, hspace=0.5)
        for i, (a, (size, gain, phase)) in enumerate(zip(found.axes, rows, strict=True)):
            loops = 1.0 / a.measured - 1.0, 1.0 / a.predicted - 1.0
            named = ("measured", "predicted") if i == 0 else (None, None)
            size.fill_between(a.frequency, a.low, a.high, color=BEFORE, alpha=0.3, lw=0)
            for ax, seen, foretold in (
                (size, np.abs(a.measured), np.abs(a.predicted)),
                (gain, *(20 * np.log10(np.abs(x)) for x in loops)),
                (phase, *(_phase(x) for x in loops)),
            ):
                ax.plot(a.frequency, seen, ".", color=AFTER, ms=3, label=named[0] if ax is size else None)
                ax.plot(a.frequency, foretold, color=BEFORE, lw=1.1, label=named[1] if ax is size else None)
                ax.set_xscale("log")
                plain_hz(ax)
            size.axhline(1.0, color=INK, lw=0.6)
            gain.axhline(0.0, color=INK, lw=0.6)
            phase.axhline(-180.0, color=INK, lw=0.6)
            phase.set_ylim(-360, 0)
            phase.set_yticks(range(-360, 1, 90))
            size.set_title(label(a.axis, 20), loc="left")
            size.set_ylabel("sensitivity |S|")
            gain.set_ylabel("loop gain [dB]")
            phase.set_ylabel("loop phase [°]")
        canvas.legend(loc="upper right", ncols=2)

    size = (10.0, 0.9 + 2.1 * len(found.axes))
    return svg("verification", fill, size=size, title="Loops as measured and as predicted")
