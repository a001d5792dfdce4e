"""Pictures and their data as files: what ``invid diagnose --plots DIR`` writes."""

from __future__ import annotations

import csv
import io
import re
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from invid.model.diagnosis_document import Diagnosis
from invid.model.document import dump_json
from invid.recording.model import Recording
from invid.recording.still_axes import moving_part
from invid.report.branch_drawing import branch_drawing
from invid.report.dependence import dependence_data, linear_model_of, replay_data
from invid.report.figures import figures, plain_hz
from invid.report.labels import label
from invid.report.style import AFTER, BEFORE, INK, MEASURED, over_frequency, svg

POINTS = 600
"""Points of a scatter in a picture; its data have them all."""


def plot_files(recording: Recording, diagnosis: Diagnosis) -> dict[str, str]:
    """Text of every file by name: ``missing-A1.svg``, ``.csv`` and ``.json``, ``replay-A1.svg`` and ``.csv``,
    the pictures of the report, and ``index.json`` with the rms figures.

    Axis names are cut down to letters, digits and dashes for file names.
    """
    recording, _ = moving_part(recording, diagnosis.model.axes)
    missing = dependence_data(recording, diagnosis.model)
    replayed = replay_data(recording, diagnosis)
    lost = diagnosis.unexplained
    files = {"branches.svg": standalone(branch_drawing(diagnosis.model, diagnosis.findings, lost))}
    for number, row in enumerate(missing):
        name = f"missing-{_stem(row['axis'], number)}"
        files[f"{name}.svg"] = standalone(dependence_picture(row, name))
        files[f"{name}.csv"] = _csv(row["waves"])
        files[f"{name}.json"] = dump_json({k: v for k, v in row.items() if k != "waves"})
    columns = ("time", "measured", "simulated_before", "simulated_after")
    for number, row in enumerate(replayed):
        name = f"replay-{_stem(row['axis'], number)}"
        files[f"{name}.svg"] = standalone(replay_picture(row, name))
        files[f"{name}.csv"] = _csv({c: row[c] for c in columns})
    for name, picture in figures(recording, linear_model_of(diagnosis), diagnosis).items():
        files.setdefault(f"{name}.svg", standalone(picture))
    index = {
        "axes": [r["axis"] for r in missing],
        "levels": {r["axis"]: r["levels"] for r in missing},
        "replay": {
            r["axis"]: {"experiment": r["experiment"], "unit": r["unit"], **r["rms"]} for r in replayed
        },
        "files": sorted(files),
    }
    files["index.json"] = dump_json(index)
    return files


def _stem(axis: str, number: int) -> str:
    plain = re.sub(r"[^A-Za-z0-9-]+", "-", axis).strip("-")[:40]
    return plain or f"axis-{number + 1}"


def _csv(columns: dict[str, list[float]]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([f"{v:.9g}" for v in row] for row in zip(*columns.values(), strict=True))
    return stream.getvalue()


def standalone(picture: str) -> str:
    """An SVG file of its own: the page's variables fall back to the light colours, on white."""
    head, rest = picture.split(">", 1)
    if "xmlns=" not in head:
        head = head.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{head} style="background:#fff">{rest}\n'


def dependence_picture(row: dict[str, Any], name: str) -> str:
    """Missing torque of one axis over frequency, time, velocity, position, acceleration, deflections."""
    waves = row["waves"]
    over = [k for k in waves if k not in ("time", "missing_torque")]
    units = {"position": "", "velocity": "/s", "acceleration": "/s²"}
    rows = 1 + (1 + len(over) + 1) // 2

    def fill(figure: Figure) -> None:
        plots = figure.subplots(rows, 2, squeeze=False).ravel()
        figure.subplots_adjust(wspace=0.24, hspace=0.42)
        _over_frequency(plots[0], row)
        plots[1].axis("off")
        unit = label(row["torque_unit"])
        _points(plots[2], waves["time"], waves["missing_torque"], "time [s]", unit, line=True)
        for ax, key in zip(plots[3:], over, strict=False):
            name_, _, number = key.partition("_")
            what = name_ + (f" of spring {number}" if number else "")
            what += f" [{label(row['position_unit'])}{units.get(key, '')}]"
            _points(ax, waves[key], waves["missing_torque"], what, unit)
        for ax in plots[3 + len(over) :]:
            ax.axis("off")
        handles, words = plots[0].get_legend_handles_labels()
        plots[1].legend(handles, words, loc="center left", title=f"{label(row['axis'])}, missing torque")
        _levels(plots[1], row)

    size = (8.6, 0.9 + 2.1 * rows)
    return svg(name, fill, size=size, title=f"Missing torque of {row['axis']} over all it may depend on")


def _over_frequency(ax: Axes, row: dict[str, Any]) -> None:
    lines = row["lines"]
    floor = lines["floor"]
    values = [v for k in lines for v in lines[k]["torque"]]
    over_frequency(ax, floor["frequency_hz"], floor["torque"], values)
    marks = (
        ("excited", "o", MEASURED, "excited lines"),
        ("odd", "^", BEFORE, "odd lines, not excited"),
        ("even", "x", AFTER, "even lines, not excited"),
    )
    for key, marker, colour, words in marks:
        hz, rms = lines[key]["frequency_hz"], lines[key]["torque"]
        if rms:
            ax.plot(hz, rms, marker, ms=2.8, mew=0.7, color=colour, label=words)
    plain_hz(ax)
    ax.set_ylabel(f"[{label(row['torque_unit'])}]")


def _points(ax: Axes, x: list[float], y: list[float], what: str, unit: str, *, line: bool = False) -> None:
    step = 1 if line else max(1, len(x) // POINTS)
    ax.plot(x[::step], y[::step], "-" if line else ".", lw=0.7, ms=2.0, color=MEASURED)
    ax.axhline(0.0, color=INK, lw=0.5)
    ax.set_xlabel(what)
    ax.set_ylabel(f"[{unit}]")
    ax.locator_params(nbins=5)


def _levels(ax: Axes, row: dict[str, Any]) -> None:
    """Rms of every record in words beside the legend: how it grows with the amplitude."""
    lines = [
        f"{r['experiment']} ({r['role']}): motion {r['motion_rms']:.2g} {row['position_unit']}, "
        f"missing {r['missing_rms']:.2g}, noise {r['noise_rms']:.2g} {row['torque_unit']}"
        for r in row["levels"][:6]
    ]
    ax.text(0.0, -0.05, "\n".join(label(x, 90) for x in lines), fontsize=6.5, va="bottom", color=INK)


def replay_picture(row: dict[str, Any], name: str) -> str:
    """Measured and simulated motion over time, and the error before and after the extension."""

    def fill(figure: Figure) -> None:
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[1, 1.2])
        time = np.array(row["time"])
        measured = np.array(row["measured"])
        top.plot(time, measured, color=MEASURED, lw=1.6, label="measured")
        series = [("simulated_before", "linear model" if row["extended"] else "model", BEFORE, "--")]
        if row["extended"]:
            series.append(("simulated_after", "with the causes named", AFTER, ":"))
        for key, words, colour, line in series:
            top.plot(time, row[key], line, color=colour, lw=1.1, label=words)
            bottom.plot(time, np.array(row[key]) - measured, color=colour, lw=0.9)
        bottom.axhline(0.0, color=INK, lw=0.5)
        top.set_ylabel(f"motion [{label(row['unit'])}]")
        bottom.set_ylabel(f"simulated − measured [{label(row['unit'])}]")
        bottom.set_xlabel("time [s]")
        top.set_title(label(f"{row['axis']} ({row['experiment']})", 32), loc="left")
        figure.legend(loc="upper right", ncols=3)

    return svg(name, fill, size=(7.2, 3.9), title=f"Motion of {row['axis']}, measured and simulated")
