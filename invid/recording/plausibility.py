"""Doubt data that read without an error and cannot be meant: what is wrong, the map's line to change,
what it would do.

Each test says what it rests on; a doubt is a sentence and stops nothing.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.numerics.arrays import Bool, Float64, Int64
from invid.recording.clock import count_slots
from invid.recording.model import Experiment, Kind, Recording
from invid.recording.roll_off import roll_off

PEAK_OVER_RATED = 10.0
"""Peak torque over rated torque from which the unit is wrong: servo motors give three to five."""
FASTEST = {"rad": 2000.0, "m": 20.0}
"""Speed [rad/s or m/s] that no drive reaches: 19,000 rev/min, and a fast gantry's four times over."""
COHERENT = 0.7
"""Mean phasor of the rows at which a value changes, about a period of p rows, from which it changes every p
rows; n changes at random have 1/√n. Rounding to whole rows leaves 0.83 at two and a half rows, more above."""
LEAST_ROWS = 1.5
"""Rows from which a value stands for several: below, some are only equal by chance."""
FEW_CHANGES = 30
"""Changes from which that is more than chance: 0.7 has then a probability of 4e-7."""
SMALLER = 0.25
"""Range of numbers as they would be with a sign over that as read, below which a sign is missing."""
_SIDES = {
    "motor": r"(^|[^a-z])(mot|motor|m|rotor|drive)([^a-z]|$)",
    "load": r"(^|[^a-z])(load|link|abtrieb|lastseitig|arm|second|secondary|joint|out|output)([^a-z]|$)",
}


@dataclass(frozen=True)
class Hold:
    """A value that stands for ``rows`` rows on the mean, new at the first from ``start`` + k · rows on."""

    rows: float
    start: float

    @property
    def whole(self) -> int | None:
        """Return for how many rows a value stands, where that is a whole number; else ``None``."""
        return round(self.rows) if abs(self.rows - round(self.rows)) < 0.02 else None

    @property
    def first(self) -> int:
        """The first row with a new value."""
        return int(np.ceil(np.mod(self.start, self.rows)))

    def is_new(self, index: Int64) -> Bool:
        """(n,) which of the rows with these numbers are the first of their value."""
        value = np.floor((np.stack((index, index - 1)) - self.start) / self.rows)
        new: Bool = value[0] > value[1]
        return new


def held_rows(values: Float64) -> Hold | None:
    """For how many rows each of (n, C) values, or of the slowest channel's, stands; ``None`` where none does.

    A slow signal of coarse steps repeats too, but at no period: what is asked is whether the changes keep
    one. Alone a channel counts only where it changes by more than its smallest step: counts at a constant
    speed keep a period as well.
    """
    together = _hold((np.diff(values, axis=0) != 0).any(axis=1))
    alone = [_hold(d != 0) for d in np.diff(values, axis=0).T if _is_coarse(d)] if values.shape[1] > 1 else []
    return max((h for h in (together, *alone) if h is not None), key=lambda h: h.rows, default=None)


def _is_coarse(changes: Float64) -> bool:
    sizes = np.abs(changes[changes != 0])
    return sizes.size > 0 and bool(np.median(sizes) > 1.5 * sizes.min())


def _hold(new: Bool) -> Hold | None:
    changed: Int64 = np.flatnonzero(new) + 1
    if changed.size < FEW_CHANGES or changed.size * LEAST_ROWS > new.size:
        return None
    clock = count_slots(changed.astype(np.float64))
    if clock.step < LEAST_ROWS or not clock.even or abs(np.exp(2j * np.pi * clock.late).mean()) < COHERENT:
        return None
    whole = abs(clock.step - round(clock.step)) < 1e-3
    # The first row after an instant has its value: up to a row late. A few stray changes do not count.
    early, late = np.quantile(changed - clock.index * clock.step, (0.01, 0.99))
    return Hold(float(round(clock.step)) if whole else clock.step, float(early + late) / 2 - 0.5)


def _hold_of(e: Experiment) -> Hold | None:
    return held_rows(np.concatenate((e.position, e.torque), axis=1))


def held_sentence(experiment: Experiment) -> str | None:
    """Return what is said of a record whose rows repeat, every value standing for several of them."""
    hold = _hold_of(experiment)
    if hold is None:
        return None
    rate = experiment.sample_rate_hz / hold.rows
    changed = np.diff(np.concatenate((experiment.position, experiment.torque), axis=1), axis=0) != 0
    every = bool(changed.any(axis=1).mean() < 1.5 / hold.rows)
    who = "every value stands" if every else "the values of a channel stand"
    return f"{who} for {hold.rows:.3g} rows: {'it was' if every else 'they were'} taken at {rate:.4g} Hz"


def without_repeats(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording with one row of each value that stands for several, and a sentence for each record.

    Held values are a motion that stands still between leaps: masses come out a thousand times too small.
    """
    experiments, said = [], []
    for e in recording.experiments:
        hold = _hold_of(e)
        if hold is None or e.kind is Kind.CONSTANT_VELOCITY:
            experiments.append(e)
            continue
        slots = count_slots(e.time)
        keep = hold.is_new(slots.index if slots.even else np.arange(e.samples, dtype=np.int64))
        rate = e.sample_rate_hz / hold.rows
        period = e.period_samples / hold.rows
        experiments.append(
            replace(
                e.cut(keep),
                sample_rate_hz=rate,
                period_samples=round(period) if abs(period - round(period)) < 1e-6 else 0,
                frequencies_hz=e.frequencies_hz[e.frequencies_hz < 0.5 * rate],
            )
        )
        said.append(f"experiment {e.key}: {held_sentence(e)}; one row of each is used")
    return replace(recording, experiments=tuple(experiments)), said


def missing_sign(raw: Float64) -> str | None:
    """How whole numbers ``raw`` (n,) have to be read so that they keep their sign; ``None`` where they do.

    Two's complement read without a sign leaps by a power of two at zero, and so does a sign bit beside a
    magnitude: read rightly the range is a fraction.
    """
    values = raw[np.isfinite(raw)]
    if values.size < 8 or np.any(values != np.round(values)):
        return None
    span = float(np.ptp(values))
    for bits in (8, 16, 24, 32):
        if span >= 2.0 ** (bits - 1) and values.max() < 2.0**bits and values.min() >= -(2.0 ** (bits - 1)):
            for kind in (f"int{bits}", f"sign{bits}"):
                if np.ptp(with_sign(values, kind)) < SMALLER * span:
                    return kind
    return None


def with_sign(values: Float64, read_as: str) -> Float64:
    """Numbers with their sign: ``read_as`` int8 … int32 in two's complement, sign8 … by a sign bit."""
    bits = int(re.sub(r"\D", "", read_as))
    code = np.mod(values, 2.0**bits)
    top = 2.0 ** (bits - 1)
    negative: Bool = code >= top
    out: Float64 = np.where(negative, code - 2 * top if read_as.startswith("int") else top - code, code)
    return out


def doubts(recording: Recording) -> list[str]:
    """Sentences on what a recording holds that its axes cannot have done."""
    said = []
    for i, axis in enumerate(recording.axes):
        torque = max(float(np.abs(e.torque[:, i]).max()) for e in recording.experiments)
        rated = None if recording.rated_torque is None else float(recording.rated_torque[i])
        if rated is not None and torque > PEAK_OVER_RATED * rated:
            said.append(
                f"axis {axis}: torque reaches {torque:.4g} {recording.torque_unit}, {torque / rated:.3g} "
                "times its rated torque; see 'unit', 'scale' and 'rated_torque' of the axis in the map: "
                "masses and springs come out by the same factor"
            )
        fastest = max(_speed(e, i) for e in recording.experiments)
        limit = FASTEST[recording.position_unit]
        if fastest > limit:
            unit = recording.position_unit
            said.append(
                f"axis {axis}: its position moves at {fastest:.4g} {unit}/s, faster than any drive "
                f"({limit:g} {unit}/s); see 'unit' and 'per_count' of its position in the map, and the unit "
                "of 'time': masses and springs come out by the square of the factor"
            )
    for e in recording.experiments:
        hold = _hold_of(e)
        if hold is not None:
            cure = (
                "log at the rate at which it is taken"
                if hold.whole is None
                else f"write 'every: {hold.whole}' in the experiment"
            )
            said.append(
                f"{held_sentence(e)}; {cure}: the repeats would be taken for motion that stands still "
                "between leaps, and masses come out far too small (identify uses one row of each)"
            )
        for i, axis in enumerate(recording.axes):
            filtered = roll_off(e, e.torque[:, i])
            if filtered is not None:
                late = 1e3 * filtered.order / (2 * np.pi * filtered.corner_hz)
                said.append(
                    f"experiment {e.key}: the torque of {axis} went through a low-pass: its noise is level "
                    f"up to {filtered.corner_hz:.3g} Hz and falls by {filtered.fall_db:.0f} dB above; name "
                    f"the 'column' of the unfiltered torque where the file has one: this one is {late:.2g} "
                    f"ms late, which counts as damping where identify does not take it out, and too small "
                    f"above the corner"
                )
    return said


def _speed(e: Experiment, axis: int) -> float:
    """Speed that one row in a hundred exceeds: single leaps are glitches, and are told elsewhere."""
    speed = np.abs(np.diff(e.position[:, axis]) / np.diff(e.time))
    return float(np.quantile(speed, 0.99))


def doubt_of_sides(axis: str, torque: str, motion: str) -> str | None:
    """A sentence where the names put torque and motion on two sides of the transmission."""
    sides = [{s for s, words in _SIDES.items() if re.search(words, n.lower())} for n in (torque, motion)]
    if any(len(s) != 1 for s in sides) or sides[0] == sides[1]:
        return None
    return (
        f"axis {axis}: {torque!r} is by its name of the {min(sides[0])} side and {motion!r} of the "
        f"{min(sides[1])} side; torque and motion must be of one side (in the map 'column' of position or "
        "torque, or 'scale' with the gear ratio where it is a name only): across a spring there is no mass "
        "to be found"
    )


def doubts_of_signs(raw: Sequence[tuple[str, str, Float64]]) -> list[str]:
    """Sentences on columns (axis and field, column, its numbers) whose sign is lost."""
    said = []
    for where, column, numbers in raw:
        kind = missing_sign(numbers)
        if kind is not None:
            bits = int(re.sub(r"\D", "", kind))
            lost = "signed number read as unsigned" if kind[0] == "i" else "sign bit beside a magnitude"
            said.append(
                f"{where}: {column!r} reaches {np.nanmax(np.abs(numbers)):.0f}: a {lost}; write 'read_as: "
                f"{kind}' beside 'column' in the map: else every change of sign is a leap of {2**bits}"
            )
    return said
