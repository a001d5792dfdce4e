"""The contract's rules for a recording in memory; every violation is one named sentence.

One set of rules for all sources: files read, files about to be written, and imported data.
"""

from __future__ import annotations

from datetime import datetime

import numpy as np

from invid.errors import RecordingError
from invid.numerics.arrays import Float64
from invid.recording.model import Experiment, Recording

COLUMNS = ("position", "torque", "torque_demand", "position_reference", "torque_feedforward")
"""Datasets of n rows and M columns, ``status`` aside; the last two are this program's own additions."""
TORQUE_UNIT = {"rad": "N·m", "m": "N"}


def check_recording(recording: Recording, *, source: str | None = None) -> None:
    """Raise RecordingError where anything in ``recording`` breaks the contract."""
    where = source or recording.source
    axes = recording.axes
    if not axes:
        raise RecordingError(f"{where}: attribute 'axes' names no axis; at least one is needed")
    if any(not name for name in axes) or len(set(axes)) != len(axes):
        raise RecordingError(
            f"{where}: attribute 'axes' is {list(axes)}; the names must differ and not be empty"
        )
    if recording.position_unit not in TORQUE_UNIT:
        raise RecordingError(
            f"{where}: attribute 'position_unit' is {recording.position_unit!r}; it must be 'rad' or 'm'"
        )
    needed = TORQUE_UNIT[recording.position_unit]
    if recording.torque_unit != needed:
        raise RecordingError(
            f"{where}: attribute 'torque_unit' is {recording.torque_unit!r}; with position in "
            f"{recording.position_unit!r} it must be {needed!r}"
        )
    try:
        datetime.fromisoformat(recording.created)
    except ValueError:
        raise RecordingError(
            f"{where}: attribute 'created' is {recording.created!r}; write an ISO 8601 time such as "
            f"'2026-01-31T12:00:00Z'"
        ) from None
    _per_axis(where, "rated_torque", recording.rated_torque, axes, positive=True)
    _per_axis(where, "encoder_resolution", recording.encoder_resolution, axes, positive=False)
    counts = recording.masses_per_axis
    if counts is not None and (len(counts) != len(axes) or min(counts) < 1):
        raise RecordingError(
            f"{where}: attribute 'masses_per_axis' is {list(counts)}; it must be {len(axes)} whole "
            f"numbers ≥ 1"
        )
    if not recording.experiments:
        raise RecordingError(f"{where}: it holds no experiment with data; nothing can be computed from it")
    keys = [e.key for e in recording.experiments]
    if len(set(keys)) != len(keys):
        raise RecordingError(f"{where}: experiment keys must differ, found {keys}")
    for experiment in recording.experiments:
        check_experiment(experiment, axes, source=where)


def _per_axis(
    where: str, name: str, values: Float64 | None, axes: tuple[str, ...], *, positive: bool
) -> None:
    if values is None:
        return
    if values.shape != (len(axes),):
        raise RecordingError(
            f"{where}: attribute {name!r} has {values.size} values for {len(axes)} axes; give one per axis"
        )
    bad = ~np.isfinite(values) | ((values <= 0) if positive else (values < 0))
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        raise RecordingError(
            f"{where}: attribute {name!r} of axis {axes[i]} is {values[i]}; it must be a finite number "
            f"{'> 0' if positive else '≥ 0'} (leave the attribute out where it is not known)"
        )


def check_experiment(experiment: Experiment, axes: tuple[str, ...], *, source: str) -> None:
    """Raise RecordingError where one experiment breaks the contract; says which sample of which axis."""
    e = experiment
    where = f"{source}: experiment {e.key}"
    count, samples = len(axes), e.time.size
    if e.time.ndim != 1:
        raise RecordingError(f"{where}: dataset 'time' has shape {e.time.shape}; it must be [n]")
    if samples < 2:
        raise RecordingError(f"{where}: dataset 'time' holds {samples} samples; at least 2 are needed")
    for name in (*COLUMNS, "status"):
        values = getattr(e, name)
        if values is None:
            continue
        if values.shape != (samples, count):
            hint = ""
            if values.shape == (count, samples):
                hint = "; it is transposed: rows are samples, columns are axes"
            raise RecordingError(
                f"{where}: dataset {name!r} has shape {values.shape}; with {samples} times and {count} axes "
                f"it must be ({samples}, {count}){hint}"
            )
        if name != "status" and not np.isfinite(values).all():
            row, axis = (int(i) for i in np.argwhere(~np.isfinite(values))[0])
            raise RecordingError(
                f"{where}: dataset {name!r} of axis {axes[axis]} is {values[row, axis]} at sample {row}; "
                f"every value must be finite: cut the record there or leave the sample out of every dataset"
            )
    if not np.isfinite(e.time).all():
        row = int(np.flatnonzero(~np.isfinite(e.time))[0])
        raise RecordingError(f"{where}: dataset 'time' is {e.time[row]} at sample {row}; it must be finite")
    steps = np.diff(e.time)
    if (steps <= 0).any():
        row = int(np.flatnonzero(steps <= 0)[0]) + 1
        how = "repeats" if steps[row - 1] == 0 else "runs backwards"
        raise RecordingError(
            f"{where}: dataset 'time' {how} at sample {row} ({float(e.time[row - 1])!r} s, then "
            f"{float(e.time[row])!r} s); it must increase strictly, in seconds, as float64"
        )
    _check_header(e, axes, where, 1.0 / float(np.median(steps)))


def _check_header(e: Experiment, axes: tuple[str, ...], where: str, nominal: float) -> None:
    """Check the root attributes; ``nominal`` is the rate at which the times step [Hz]."""
    count = len(axes)
    if not -1 <= e.excited_axis < count:
        raise RecordingError(
            f"{where}: attribute 'excited_axis' is {e.excited_axis}; it must be an axis index 0…{count - 1}, "
            f"or −1 for none or several"
        )
    if e.hold_gain.shape != (count,):
        raise RecordingError(
            f"{where}: attribute 'hold_gain' has {e.hold_gain.size} values for {count} axes; "
            f"give one per axis"
        )
    bad = np.isinf(e.hold_gain) | (e.hold_gain < 0)
    if bad.any():
        i = int(np.flatnonzero(bad)[0])
        raise RecordingError(
            f"{where}: attribute 'hold_gain' of axis {axes[i]} is {e.hold_gain[i]}; it must be ≥ 0 "
            f"(0 free) or NaN (held inside the drive)"
        )
    if e.period_samples < 0:
        raise RecordingError(
            f"{where}: attribute 'period_samples' is {e.period_samples}; it must be ≥ 0 (0: not periodic)"
        )
    if not (np.isfinite(e.sample_rate_hz) and e.sample_rate_hz > 0):
        raise RecordingError(
            f"{where}: attribute 'sample_rate_hz' is {e.sample_rate_hz}; it must be a finite number > 0"
        )
    # A factor of two is far beyond jitter and dropped samples: it is a wrong unit (ms for s).
    if not 0.5 <= nominal / e.sample_rate_hz <= 2.0:
        raise RecordingError(
            f"{where}: attribute 'sample_rate_hz' is {e.sample_rate_hz:g} but 'time' steps at {nominal:g} Hz "
            f"(median); 'time' must be in seconds and agree with the rate"
        )
    f = e.frequencies_hz
    if f.ndim != 1:
        raise RecordingError(f"{where}: attribute 'frequencies_hz' has shape {f.shape}; it must be a list")
    wrong = ~np.isfinite(f) | (f < 0) | (f > 0.5 * e.sample_rate_hz * (1 + 1e-9))
    if wrong.any():
        raise RecordingError(
            f"{where}: attribute 'frequencies_hz' holds {f[wrong][0]}; lines must lie between 0 and half the "
            f"sample rate ({0.5 * e.sample_rate_hz:g} Hz)"
        )
