"""Draws the pictures of docs/tutorial/real-machines.md: ``python docs/real_pictures.py [OUT] [--all]``.

Ships only pictures of records whose licence allows it (MIT, BSD-3); the others are drawn with ``--all``.
"""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from invid.cli.app import run
from invid.recording import read_recording
from invid.rigid_motion.analysis import Analysis, analyse

ROOT = Path(__file__).resolve().parents[1]
DATA = FETCHED if (FETCHED := ROOT / "records").is_dir() else ROOT.parent / "shared" / "data"
# Okabe and Ito: told apart without colour vision.
MEASURED, RIGID, NAMED = "#000000", "#e69f00", "#0072b2"
# picture, record, map, axis, whether its licence lets it be shipped
PICTURES = (
    ("real-screw-drive-1", "screw_drives/driveNo1", "screw_drive_1", 0, True),
    ("real-screw-drive-3", "screw_drives/driveNo3", "screw_drive_3", 0, True),
    ("real-pendulum", "double_pendulum", "double_pendulum", 0, True),
    ("real-robot-axis", "kr300", "kr300", 0, True),
    ("real-ball-screw", "emps", "emps", 0, False),
    ("real-oscillator", "silverbox", "silverbox", 0, False),
)


def analysed(source: str, chart: str) -> Analysis:
    """The record through its map, and its fit."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        out = Path(folder) / "record.h5"
        chart_file = ROOT / "configs" / "import" / f"{chart}.yaml"
        if run(["import", str(DATA / source), "--map", str(chart_file), "-o", str(out)]) != 0:
            raise SystemExit(f"{source}: cannot be imported")
        return analyse(read_recording(out))


def draw(a: Analysis, axis: int) -> Figure:
    """Torque over speed for constant speeds, else over time: measured, rigid, with the causes."""
    figure, place = plt.subplots(figsize=(7.2, 3.0), layout="constrained")
    unit = a.recording.torque_unit
    mine = a.rows.axis == axis
    told, final, base = (x[mine] for x in (a.rows.torque, a.final.held_out, a.base.held_out))
    if a.reach.steady:
        speed = np.array([m.velocity[0, axis] for m in a.rows.motions])
        order = np.argsort(speed)
        place.plot(speed[order], 1e3 * told[order], "o", ms=4, color=MEASURED, label="measured")
        place.plot(speed[order], 1e3 * (told - final)[order], "-", color=NAMED, label="named, speed kept out")
        place.set(xlabel="speed [rad/s]", ylabel=f"torque [m{unit}]")
    else:
        motion = max(a.rows.motions, key=lambda m: int(m.keep.sum()))
        at = sum(int(m.keep.sum()) for m in a.rows.motions[: a.rows.motions.index(motion)])
        count = int(motion.keep.sum())
        rows = slice(at, at + count)
        time = np.flatnonzero(motion.keep) * motion.row_step
        gaps = np.flatnonzero(np.diff(time) > 1.5 * motion.row_step) + 1

        def broken(values: np.ndarray) -> np.ndarray:
            return np.insert(values, gaps, np.nan)

        place.plot(broken(time), broken(told[rows]), color=MEASURED, lw=1.6, label="measured")
        place.plot(broken(time), broken((told - base)[rows]), color=RIGID, lw=1.0, label="rigid model")
        place.plot(
            broken(time), broken((told - final)[rows]), color=NAMED, lw=1.0, label="with the causes, kept out"
        )
        place.set(xlabel="time [s]", ylabel=f"torque of {a.recording.axes[axis]} [{unit}]")
    place.grid(alpha=0.3)
    place.legend(frameon=False, fontsize=8, loc="best")
    return figure


def main(arguments: list[str]) -> int:
    """Draw all pictures whose data are there; the exit status counts those that are not."""
    mpl.use("svg")
    mpl.rcParams["svg.hashsalt"] = "invid"
    everything = "--all" in arguments
    folders = [a for a in arguments if not a.startswith("--")]
    out = Path(folders[0]) if folders else ROOT / "docs" / "images"
    out.mkdir(parents=True, exist_ok=True)
    missing = 0
    for name, source, chart, axis, ship in PICTURES:
        if not (ship or everything):
            continue
        if not (DATA / source).exists():
            print(f"NOT DRAWN: {name}: {DATA / source} is not there", file=sys.stderr)
            missing += 1
            continue
        figure = draw(analysed(source, chart), axis)
        figure.savefig(out / f"{name}.svg", metadata={"Date": None})
        plt.close(figure)
        print(out / f"{name}.svg")
    return missing


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
