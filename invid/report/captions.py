"""What stands under each picture: what it shows, and its figures for whoever cannot see it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

BRANCHES = (
    "The drives as the model sees them, with their numbers. The findings are marked where they act: a "
    "triangle asks to act, a diamond to watch, a circle is as expected, a square is not judged."
)


def captions_of(data: Mapping[str, Any]) -> dict[str, str]:
    """Text under each picture of ``figure_data``, by the picture's name; with that of ``branches``."""
    captions = {
        "branches": BRANCHES,
        "residual": "Torque that each motor would still need for the measured motion, on data that no fit "
        "has seen: with the linear model, with the causes named, and what noise alone would leave. "
        + "; ".join(
            f"{r['axis']} {r['before']:.2g}, {r['after']:.2g} and {r['noise_floor']:.2g} {r['unit']}"
            for r in data["residual"]
        )
        + ".",
        "missing-torque": "Torque that each motor would still need, over frequency, under the linear model. "
        "Where the grey floor rises, the plant amplifies the sensors' noise (resonances with the motors "
        "held): no fault there." + "".join(_most(row) for row in data["missing_torque"]),
    }
    for number, cause in enumerate(data["causes"], 1):
        what = cause["x_label"].split(" [")[0]
        drawn = f" The line is the fitted {cause['cause'].replace('_', ' ')}." if cause["cause"] else ""
        note = f" ({cause['note']})" if cause["note"] else ""
        spread = f" {len(cause['y'])} points from {_span(cause['y'], cause['y_label'])}."
        captions[f"cause-{number}"] = f"What {cause['axis']} is missing, over {what}{note}.{drawn}{spread}"
    for number, axis in enumerate(data["frf"], 1):
        peaks = ", ".join(f"{peak:.4g}" for peak in axis["peaks_hz"])
        captions[f"frf-{number}"] = (
            f"{axis['axis']}: motion per torque, measured and simulated"
            + (", before and after on one scale." if "after" in axis["simulated"] else ".")
            + (f" Peaks at {peaks} Hz." if peaks else "")
            + _agreement(axis)
        )
    return captions


def _most(row: Mapping[str, Any]) -> str:
    """ " A1: most at 6.1 Hz, 1.4 N·m." of the lines that were shaken."""
    lines = row["excited"]
    if not lines["before"]:
        return ""
    at = int(np.argmax(lines["before"]))
    most = f"{lines['before'][at]:.2g} {row['unit']}"
    return f" {row['axis']}: most at {lines['frequency_hz'][at]:.3g} Hz, {most}."


def _span(values: list[float], label: str) -> str:
    unit = label.rpartition("[")[2].rstrip("]")
    return f"{min(values):.2g} to {max(values):.2g} {unit}" if values else "none"


def _agreement(axis: Mapping[str, Any]) -> str:
    """By how much measured and simulated magnitudes differ in the median."""
    if axis["measured"] is None:
        return ""
    hz, measured = np.array(axis["measured"]["frequency_hz"]), np.array(axis["measured"]["magnitude"])
    said = []
    for name, words in (
        ("before", "with the linear model"),
        ("after", "with the linear part of the extended model"),
    ):
        if name in axis["simulated"] and measured.size:
            curve = np.interp(hz, axis["frequency_hz"], axis["simulated"][name]["magnitude"])
            off = float(np.median(np.abs(measured - curve) / np.maximum(np.abs(curve), 1e-300)))
            said.append(f"{100 * off:.2g} % {words}")
    return f" Measured and simulated differ by {' and '.join(said)}, in the median." if said else ""


def replay_caption(row: Mapping[str, Any]) -> str:
    """Of a recorded torque played through the model."""
    rms = row["rms"]
    seen = "which no fit has seen" if row["role"] == "validate" else "which the fit has seen"
    text = (
        f"{row['axis']}: the recorded torque through the model, against the measured motion, in experiment "
        f"{row['experiment']}, {seen}. The simulation is off by {rms['error_before']:.2g} {row['unit']} rms"
    )
    if row["extended"]:
        text += f" without and {rms['error_after']:.2g} {row['unit']} with the causes named"
    return f"{text}, of {rms['motion']:.2g} {row['unit']} of motion."
