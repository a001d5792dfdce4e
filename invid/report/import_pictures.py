"""Pictures of imported files to look at: torque, speed and position of every axis over time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from invid.recording.import_source import clock_time
from invid.recording.model import Experiment, Recording
from invid.report.style import MEASURED

MOST_POINTS = 20_000
"""Points of a curve, of which every n-th is drawn; a longer record looks the same."""


def draw_files(read: Sequence[tuple[Path, Recording]], folder: Path) -> list[str]:
    """Write a PNG for every experiment of the files that were read, and return their names."""
    folder.mkdir(parents=True, exist_ok=True)
    names = []
    for number, (path, recording) in enumerate(read):
        for e in recording.experiments:
            names.append(f"{number:02d}-{path.stem}-{e.key}.png")
            _picture(e, recording, path.name).savefig(folder / names[-1], dpi=110)
    return names


def _picture(e: Experiment, recording: Recording, title: str) -> Figure:
    axes = recording.axes
    figure = Figure(figsize=(4.0 + 4.0 * len(axes), 7.0), layout="constrained")
    figure.suptitle(f"{title}, experiment {e.key} ({e.role}), {e.samples} rows")
    grid = figure.subplots(3, len(axes), sharex=True, squeeze=False)
    every = max(e.samples // MOST_POINTS, 1)
    time = clock_time(e)
    for i, axis in enumerate(axes):
        speed = np.gradient(e.position[:, i], time)
        rows = (
            ("torque", recording.torque_unit, e.torque[:, i]),
            ("speed", f"{recording.position_unit}/s", speed),
            ("position", recording.position_unit, e.position[:, i]),
        )
        for row, (name, unit, values) in enumerate(rows):
            panel = grid[row, i]
            panel.plot(time[::every], values[::every], color=MEASURED, linewidth=0.6)
            panel.set_ylabel(f"{name} of {axis} [{unit}]")
            panel.grid(alpha=0.3)
        grid[2, i].set_xlabel("time [s]")
    return figure
