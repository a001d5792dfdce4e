"""A tuning on one page (Bode plot of every loop, the reference move, values, margins);
a verification as a document, a sentence an axis and a picture, measured beside predicted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from operator import attrgetter
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from invid.model.document import with_numbers
from invid.report.figures import plain_hz
from invid.report.labels import label, printable
from invid.report.style import AFTER, BEFORE, INK, svg
from invid.tuning.document import values_of
from invid.tuning.gains import PROMISE
from invid.tuning.margins import drawn_plants
from invid.tuning.tune import SPREAD_DRAWS, AxisTuning, Tuning
from invid.tuning.verification import AxisVerification, Verdict, Verification
from invid.wording.sentence import Figure as Said
from invid.wording.sentence import sentence, stated

SIDES = (("before", BEFORE, "--"), ("after", AFTER, "-"))


def bode_and_move(tuning: Tuning) -> str:
    """SVG: a row an axis with gain and phase of its loop, broken at the torque, and its load in the move."""
    drawn = drawn_plants([tuning.plant], tuning.settings.timing)
    hz = drawn.omega[0] / (2 * math.pi)
    loops = {s: drawn.loops([getattr(a, s).gains for a in tuning.axes])[0] for s, *_ in SIDES}
    runs = {"before": tuning.run_before, "after": tuning.run_after}
    unit = "mm" if tuning.model.linear else "mrad"

    def fill(figure: Figure) -> None:
        rows = figure.subplots(len(tuning.axes), 3, squeeze=False)
        figure.subplots_adjust(wspace=0.3, hspace=0.5)
        for i, (axis, (gain, phase, move)) in enumerate(zip(tuning.axes, rows, strict=True)):
            for side, colour, line in SIDES:
                loop = loops[side][:, i]
                gain.plot(
                    hz,
                    20 * np.log10(np.abs(loop)),
                    line,
                    color=colour,
                    lw=1.1,
                    label=side if i == 0 else None,
                )
                turn = _phase(loop)
                turn[1:][np.abs(np.diff(turn)) > 180.0] = np.nan  # around the edge of the picture
                phase.plot(hz, turn, line, color=colour, lw=1.1)
                run = runs[side]
                away = 1e3 * (run.load[:, i] - run.command[:, i])
                move.plot(run.time, away, line, color=colour, lw=1.1)
            _loop_axes(gain, phase)
            gain.set(xlim=(hz[0], hz[-1]), ylim=(-60, 80))
            phase.set_xlim(hz[0], hz[-1])
            for at in (tuning.command.arrived, 2 * tuning.command.leaves - tuning.command.arrived):
                move.axvline(at * tuning.settings.timing.cycle, color=INK, lw=0.6, ls=":")
            gain.set_title(label(axis.axis, 20), loc="left")
            move.set_ylabel(f"load − command [{unit}]")
            calm = 1e3 * np.abs(tuning.run_after.load[:, i] - tuning.run_after.command[:, i])
            most = max(float(np.nanmax(calm, initial=1e-9)) * 2.5, 1e-9)
            move.set_ylim(-most, most)
        rows[-1][2].set_xlabel("time [s], dotted: the command stands")
        figure.legend(loc="upper right", ncols=2)

    size = (10.0, 0.9 + 2.1 * len(tuning.axes))
    return svg("tuning", fill, size=size, title="Loops and the reference move before and after tuning")


def _loop_axes(gain: Axes, phase: Axes) -> None:
    """Scales and lines of a loop's gain and phase over frequency."""
    for ax, level, words in ((gain, 0.0, "loop gain [dB]"), (phase, -180.0, "loop phase [°]")):
        ax.axhline(level, color=INK, lw=0.6)
        ax.set(xscale="log", ylabel=words)
        plain_hz(ax)
        ax.xaxis.set_major_locator(LogLocator(10))  # three narrow pictures side by side
    phase.set(ylim=(-360, 0), yticks=range(-360, 1, 90))


def _phase(loop: Any) -> Any:
    return np.degrees(np.angle(-loop)) - 180.0


def tuning_picture(tuning: Tuning) -> str:
    """``bode_and_move`` as a file of its own."""
    head, rest = bode_and_move(tuning).split(">", 1)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{head} style="background:#fff">{rest}\n'


def tuning_page(tuning: Tuning, losses: Mapping[str, tuple[str, ...]]) -> str:
    """Self-contained HTML: no network, no scripts; all that comes from data is escaped."""
    environment = Environment(
        loader=PackageLoader("invid.tuning", ""), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters["clean"] = lambda text: printable(str(text), 2000)
    unit = "m" if tuning.model.linear else "rad"
    return environment.get_template("tuning.html.j2").render(
        robot=tuning.model.robot,
        headline=headline(tuning),
        picture=bode_and_move(tuning),
        axes=[_axis_rows(a, unit) for a in tuning.axes],
        values=[(v.axis, v.name, number(v.before), number(v.after), v.unit) for v in values_of(tuning)],
        remarks=tuning.remarks,
        losses=dict(losses),
        before=tuning.before_source,
        draws=tuning.settings.draws,
        promise=PROMISE,
    )


def headline(tuning: Tuning) -> str:
    """One sentence: what the new values bring, and what they leave."""
    peak = max(a.after.margins.sensitivity for a in tuning.axes)
    unit = "mm" if tuning.model.linear else "mrad"
    old, new = (max(1e3 * getattr(a, side).move.following for a in tuning.axes) for side, *_ in SIDES)
    return (
        f"following error at most {number(new)} {unit} rms in the reference move, before {number(old)}; "
        f"peak of sensitivity at most {peak:.2f} in {tuning.settings.draws} draws of the model"
    )


def number(value: float | None) -> str:
    """Four digits; a dash for what there is not."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.4g}"


_ROWS = (
    ("worst peak of sensitivity", "margins.sensitivity", 1.0),
    ("worst gain margin (factor)", "margins.gain", 1.0),
    ("worst phase margin [°]", "margins.phase", 1.0),
    ("draws that are unstable [%]", "margins.unstable", 100.0),
    ("rms following error [m{unit}]", "move.following", 1e3),
    ("rms error at the load [m{unit}]", "move.at_load", 1e3),
    ("settling of the load [s]", "move.settling", 1.0),
    ("overshoot of the load [%]", "move.overshoot", 100.0),
)
"""Of either side of an axis, and by how much it is shown."""


def _axis_rows(a: AxisTuning, unit: str) -> tuple[str, list[tuple[str, str, str]]]:
    rows = [*_ROWS]
    if math.isfinite(a.after.margins.ripple / a.rated_torque):
        share = 100.0 / a.rated_torque
        rows.append(("torque that counts make, rms [% of rated]", "margins.ripple", share))
    shown = [
        (
            name.format(unit=unit),
            number(times * attrgetter(of)(a.before)),
            number(times * attrgetter(of)(a.after)),
        )
        for name, of, times in rows
    ]
    span = " … ".join(number(1e3 * x) for x in a.spread["at_load"])
    many = f"the same in {SPREAD_DRAWS} machines of the covariance, at the load [m{unit}]"
    return a.axis, [*shown, (many, "–", span)]


# --- verification -----------------------------------------------------------------------------------
VERIFICATION_FORMAT = "invid-verification"
_FIGURES = ("sensitivity", "gain_margin", "phase_margin", "ripple", "following", "settling", "wander")


def verification_to_json(found: Verification) -> dict[str, Any]:
    """The ``invid-verification`` document."""
    document: dict[str, Any] = with_numbers(
        {
            "format": VERIFICATION_FORMAT,
            "format_version": 1,
            "robot": found.robot,
            "verdict": str(found.verdict),
            "sentences": [axis_sentence(a) for a in found.axes],
            "axes": [_axis_to_json(a) for a in found.axes],
        }
    )
    return document


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


_VERDICTS = {
    Verdict.AS_PREDICTED: sentence("as predicted"),
    Verdict.BETTER: sentence("better than predicted"),
    Verdict.WORSE: sentence("WORSE than predicted"),
    Verdict.OTHER: sentence("not the machine of the model, with margins no worse than predicted"),
    Verdict.CANNOT_TELL: sentence("too uncertain to tell: shake with more torque"),
}


def axis_sentence(a: AxisVerification) -> str:
    """One axis: verdict, peak of sensitivity, phase margin and following error as measured and predicted,
    ripple, the undo where the values stand on what was not found."""
    peak, phase = a.sensitivity, a.phase_margin
    parts = [
        sentence(
            "{axis}: {verdict}: peak of sensitivity {peak}, predicted {foretold}; phase margin "
            "{phase}°, predicted {phases}°",
            axis=a.axis,
            verdict=_VERDICTS[a.verdict],
            peak=Said(f"{peak.measured:.2f} ± {peak.std:.2f}"),
            foretold=Said(f"{peak.low:.2f} … {peak.high:.2f}"),
            phase=Said(f"{phase.measured:.0f}"),
            phases=Said(f"{phase.low:.0f} … {phase.high:.0f}"),
        )
    ]
    if a.verdict.asks_for_undo:
        parts.append(sentence("most at {frequency} Hz", frequency=Said(f"{a.worst_at:.1f}")))
    share = 100.0 * a.ripple.measured / a.rated
    if math.isfinite(share):
        parts.append(sentence("torque that does not repeat {share} % of rated", share=Said(f"{share:.2f}")))
    missed, wander = Said(f"{1e3 * a.following.measured:.2g}"), Said(f"{1e3 * a.wander.measured:.2g}")
    foretold = Said(f"{1e3 * a.following.low:.2g} … {1e3 * a.following.high:.2g}")
    parts.append(
        sentence(
            "the reference move misses by {error} {unit} rms with the loop measured, foretold {foretold}",
            error=missed,
            foretold=foretold,
            unit=f"m{a.unit}",
        )
    )
    if a.wander.measured > a.following.high:
        parts.append(
            sentence(
                "it wanders by {error} {unit} though nothing asks it to: it is not held",
                error=wander,
                unit=f"m{a.unit}",
            )
        )
    if a.verdict.asks_for_undo:
        parts.append(sentence("write the old values back"))
    return stated(parts)


def verification_picture(found: Verification) -> str:
    """SVG: a row an axis with |S|, and gain and phase of its loop, measured points on the predicted line."""

    def fill(canvas: Figure) -> None:
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
            _loop_axes(gain, phase)
            size.axhline(1.0, color=INK, lw=0.6)
            size.set_title(label(a.axis, 20), loc="left")
            size.set(xscale="log", ylabel="sensitivity |S|")
            plain_hz(size)
        canvas.legend(loc="upper right", ncols=2)

    size = (10.0, 0.9 + 2.1 * len(found.axes))
    return svg("verification", fill, size=size, title="Loops as measured and as predicted")
