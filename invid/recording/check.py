"""The contract's rules for a recording in memory; every violation is one named sentence.

One set of rules for all sources: files read, files about to be written, and imported data.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any

import numpy as np

from invid.errors import RecordingError
from invid.numerics.arrays import Bool
from invid.recording.model import Experiment, Recording

TORQUE_UNIT = {"rad": "N·m", "m": "N"}
_UNKNOWN = "(leave the attribute out where it is not known)"


def check_recording(recording: Recording, *, source: str | None = None) -> None:
    """Raise RecordingError where anything in ``recording`` breaks the contract."""
    r, axes, where = recording, list(recording.axes), source or recording.source
    needed = TORQUE_UNIT.get(r.position_unit)
    masses, rated, counts = r.masses_per_axis, r.rated_torque, r.encoder_resolution
    are_masses = masses is None or (len(masses) == len(axes) and min(masses) >= 1)
    positive = rated is None or np.isfinite(rated) & (rated > 0)
    not_negative = counts is None or np.isfinite(counts) & (counts >= 0)
    _require(
        where,
        axes,
        ("axes", axes, bool(axes), "the names of the axes; at least one is needed"),
        ("axes", axes, all(axes) and len(set(axes)) == len(axes), "names that differ and are not empty"),
        ("position_unit", r.position_unit, needed is not None, "'rad' or 'm'"),
        ("torque_unit", r.torque_unit, r.torque_unit == needed, f"{needed!r} beside {r.position_unit!r}"),
        ("created", r.created, _is_instant(r.created), "an ISO 8601 time such as '2026-01-31T12:00:00Z'"),
        ("rated_torque", rated, positive, f"a finite number > 0 {_UNKNOWN}"),
        ("encoder_resolution", counts, not_negative, f"a finite number ≥ 0 {_UNKNOWN}"),
        ("masses_per_axis", list(masses or ()), are_masses, f"{len(axes)} whole numbers ≥ 1"),
    )
    if not r.experiments:
        raise RecordingError(f"{where}: it holds no experiment with data; nothing can be computed from it")
    keys = [e.key for e in r.experiments]
    if len(set(keys)) != len(keys):
        raise RecordingError(f"{where}: experiment keys must differ, found {keys}")
    for experiment in r.experiments:
        check_experiment(experiment, r.axes, source=where)


def check_experiment(experiment: Experiment, axes: tuple[str, ...], *, source: str) -> None:
    """Raise RecordingError where one experiment breaks the contract; says which sample of which axis."""
    e, where = experiment, f"{source}: experiment {experiment.key}"
    samples, count = e.time.size, len(axes)
    if samples < 2:
        raise RecordingError(f"{where}: dataset 'time' holds {samples} samples; at least 2 are needed")
    for name, values in e.datasets().items():
        shape = (samples,) if name == "time" else (samples, count)
        if values.shape != shape:
            is_turned = values.shape == (count, samples)
            hint = "; it is transposed: rows are samples, columns are axes" if is_turned else ""
            raise RecordingError(
                f"{where}: dataset {name!r} has shape {values.shape}; with {samples} times and {count} axes "
                f"it must be {shape}{hint}"
            )
        if not np.isfinite(values).all():
            row, *axis = np.argwhere(~np.isfinite(values))[0].tolist()
            of = f" of axis {axes[axis[0]]}" if axis else ""
            raise RecordingError(
                f"{where}: dataset {name!r}{of} is {values[(row, *axis)]} at sample {row}; every value must "
                "be finite: cut the record there or leave the sample out of every dataset"
            )
    steps = np.diff(e.time)
    if (steps <= 0).any():
        row = int(np.flatnonzero(steps <= 0)[0]) + 1
        how = "repeats" if steps[row - 1] == 0 else "runs backwards"
        raise RecordingError(
            f"{where}: dataset 'time' {how} at sample {row} ({float(e.time[row - 1])!r} s, then "
            f"{float(e.time[row])!r} s); it must increase strictly, in seconds, as float64"
        )
    rate, nominal, lines = e.sample_rate_hz, 1.0 / float(np.median(steps)), e.frequencies_hz
    wrong = ~np.isfinite(lines) | (lines < 0) | (lines > 0.5 * rate * (1 + 1e-9))
    is_hold = ~np.isinf(e.hold_gain) & ~(e.hold_gain < 0)
    _require(
        where,
        list(axes),
        (
            "excited_axis", e.excited_axis, -1 <= e.excited_axis < count,
            f"an axis index 0…{count - 1}, or −1 for none or several",
        ),
        ("hold_gain", e.hold_gain, is_hold, "≥ 0 (0 free) or NaN (held inside the drive)"),
        ("period_samples", e.period_samples, e.period_samples >= 0, "≥ 0 (0: not periodic)"),
        ("sample_rate_hz", rate, bool(np.isfinite(rate)) and rate > 0, "a finite number > 0"),
        (
            # A factor of two is far beyond jitter and dropped samples: it is a wrong unit (ms for s).
            "sample_rate_hz", rate, rate > 0 and 0.5 <= nominal / rate <= 2.0,
            f"the rate of 'time', which steps at {nominal:g} Hz (median) and must be in seconds",
        ),
        (
            "frequencies_hz", lines[wrong][:1].tolist(), not wrong.any(),
            f"lines between 0 and half the sample rate ({0.5 * rate:g} Hz)",
        ),
    )  # fmt: skip


def _require(where: str, axes: list[str], *rules: tuple[str, Any, bool | Bool, str]) -> None:
    """RecordingError by the first rule that is broken.

    A rule is an attribute, its value, whether that is right (for each axis where there is one for each), and
    what it must be.
    """
    for name, value, right, needed in rules:
        said = f"attribute {name!r}"
        if isinstance(right, np.ndarray):
            if value.shape != (len(axes),):
                raise RecordingError(
                    f"{where}: {said} has {value.size} values for {len(axes)} axes; give one per axis"
                )
            worst = int(np.argmin(right))
            said, value, right = f"{said} of axis {axes[worst]}", value[worst].item(), bool(right[worst])
        if not right:
            raise RecordingError(f"{where}: {said} is {value!r}; it must be {needed}")


def _is_instant(text: str) -> bool:
    try:
        datetime.fromisoformat(text)
    except ValueError:
        return False
    return True
