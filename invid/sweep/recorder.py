"""Write the samples of a sweep into a recording, gaps filled and counted.

A lost TPDO or a skipped SYNC slot leaves a hole in an otherwise even record. The period grid must not
slip for it, so every slot gets a row: positions are filled by a cubic through their neighbours (at
1 kHz and 12 Hz its error is below 1e-5 of the amplitude), torques linearly, the demand is the one the
drive went on holding. How many were filled stands in the experiment's attributes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from invid.numerics.arrays import Float64
from invid.planning.model import PlannedExperiment
from invid.recording import Outcome, RecordingWriter
from invid.sweep.ports import Sample

BLOCK_S = 0.25
"""Handed to the writer at once; the writer flushes every second, so a kill loses little more than that."""
CONTEXT_ROWS = 8
"""Rows of the block before, and rows kept back for the next, that a cubic may lean on."""

_NAN = float("nan")


class Recorder:
    """A ``Sink`` that writes; the file is opened with the first row, not before."""

    def __init__(self, open_writer: Callable[[], RecordingWriter], cycle_s: float, axes: int) -> None:
        self._open, self._cycle, self._count = open_writer, cycle_s, axes
        self._block = max(CONTEXT_ROWS, round(BLOCK_S / cycle_s)) + CONTEXT_ROWS
        self._writer: RecordingWriter | None = None
        self._header: tuple[PlannedExperiment, list[float], float] | None = None
        self._last_slot: int | None = None
        self.filled = 0
        self.skipped = 0
        self._reset()

    def _reset(self) -> None:
        self._time: list[float] = []
        self._position: list[list[float]] = []
        self._torque: list[list[float]] = []
        self._demand: list[list[float]] = []
        self._status: list[list[int]] = []
        self._written = 0
        self._holes = False

    def begin(self, experiment: PlannedExperiment, hold_gain: Sequence[float], scale: float) -> None:
        """Begin a new experiment."""
        self._reset()
        self._last_slot = None
        self._header = (experiment, list(hold_gain), scale)

    def _open_experiment(self) -> None:
        """Open an experiment with its first row: one stopped while it settled leaves no empty shell."""
        if self._header is None:
            return
        experiment, hold_gain, scale = self._header
        self._header = None
        if self._writer is None:
            self._writer = self._open()
        self._writer.begin(
            kind=experiment.kind,
            role=experiment.role,
            excited_axis=experiment.excited_axis,
            hold_gain=hold_gain,
            period_samples=experiment.period_samples,
            frequencies_hz=experiment.frequencies_hz,
            sample_rate_hz=1.0 / self._cycle,
            attributes={**experiment.attributes, "amplitude_scale": scale, "hold_by": "master"},
        )

    def row(self, sample: Sample, demand: Sequence[float]) -> None:
        """Take one cycle."""
        if self._header is not None:
            self._open_experiment()
        last = self._last_slot
        if last is not None and sample.slot > last + 1:
            self._skip(sample, last)
        self._last_slot = sample.slot
        self._time.append(sample.time)
        if all(sample.fresh):
            self._position.append(list(sample.position))
            self._torque.append(list(sample.torque))
        else:
            self._holes = True
            self.filled += sample.fresh.count(False)
            pairs = zip(sample.position, sample.torque, sample.fresh, strict=True)
            rows = [(x, t) if f else (_NAN, _NAN) for x, t, f in pairs]
            self._position.append([x for x, _ in rows])
            self._torque.append([t for _, t in rows])
        self._demand.append(list(demand))
        self._status.append(list(sample.status))
        if len(self._time) - self._written >= self._block:
            self._flush(len(self._time) - CONTEXT_ROWS)

    def _skip(self, sample: Sample, last: int) -> None:
        missing = sample.slot - last - 1
        self._holes = True
        self.skipped += missing
        before = self._time[-1]
        step = (sample.time - before) / (missing + 1)
        for j in range(1, missing + 1):
            self._time.append(before + j * step)
            self._position.append([_NAN] * self._count)
            self._torque.append([_NAN] * self._count)
            self._demand.append(self._demand[-1])
            self._status.append(self._status[-1])

    def _flush(self, upto: int) -> None:
        if self._writer is None or upto <= self._written:
            return
        time = np.asarray(self._time)
        position, torque = np.asarray(self._position), np.asarray(self._torque)
        if self._holes:
            position, torque = fill_gaps(time, position, cubic=True), fill_gaps(time, torque, cubic=False)
        rows = slice(self._written, upto)
        self._writer.append(
            time[rows],
            position[rows],
            torque[rows],
            np.asarray(self._demand[rows]),
            np.asarray(self._status[rows], dtype=np.uint16),
        )
        keep = max(0, upto - CONTEXT_ROWS)
        # what was written stays as written, for the next block to lean on; what follows stays open
        context = slice(keep, upto)
        self._position = position[context].tolist() + self._position[upto:]
        self._torque = torque[context].tolist() + self._torque[upto:]
        self._time, self._demand = self._time[keep:], self._demand[keep:]
        self._status = self._status[keep:]
        self._written = upto - keep
        self._holes = bool(np.isnan(np.asarray(self._position)).any())

    def end(self) -> None:
        """End the experiment."""
        self._flush(len(self._time))
        if self._writer is not None and self._header is None:
            self._writer.end()
        self._header = None
        self._reset()

    def close(self, outcome: Outcome) -> None:
        """Mark and close the file, if there is one."""
        if self._writer is not None:
            self._writer.close(outcome)


def fill_gaps(time: Float64, values: Float64, *, cubic: bool) -> Float64:
    """(n, M) with NaN replaced from neighbours in time; the ends hold the nearest value."""
    result = values.copy()
    for i in range(values.shape[1]):
        column = values[:, i]
        known = np.flatnonzero(~np.isnan(column))
        missing = np.flatnonzero(np.isnan(column))
        if not missing.size or not known.size:
            continue
        inner = missing[(missing > known[0]) & (missing < known[-1])]
        if cubic and known.size >= 4:
            result[inner, i] = CubicSpline(time[known], column[known])(time[inner])
        else:
            result[inner, i] = np.interp(time[inner], time[known], column[known])
        result[missing[missing < known[0]], i] = column[known[0]]
        result[missing[missing > known[-1]], i] = column[known[-1]]
    return result
