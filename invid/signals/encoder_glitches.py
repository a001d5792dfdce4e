"""Repair encoder readings that no motion explains: single wrong samples, lost counts, wraps.

A mass does not leave its path for one sample and come back, nor jump and go on as before. Either is one
number in a smooth series: the sample itself, or one of its differences. It is told by how far it is from the
polynomial through four neighbours on either side, δ⁸/70, and by what taking it out leaves of that in the
neighbours. A change of slope (a knock, a torque of one sample) looks alike but leaves 6.5 % there, rms.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.numerics.arrays import Bool, Float64, Int64
from invid.recording.model import Experiment, Recording

LEAST_DEVIATION = 40.0
"""Standard deviations of δ⁸/70 over the record (from its median size) from which a sample is off. Noise
leaves 1/FAR of that in the neighbours, which must be told from the 6.5 % of a knock; what is nearer does the
spectra little harm."""
MOST_REMAINDER = 0.045
"""Rms of δ⁸/70 in the eight neighbours, over that of the sample taken out, above which it was no glitch:
between 1/FAR and 6.5 %."""
LEAST_COUNTS = 20.0
"""Least size of a glitch in counts of the encoder (empirical): an axis that sticks may slip some counts
within a sample and stand again."""
MOST_SHARE = 1 / 64
"""Share of samples above which they are no exceptions, and nothing is repaired."""
WHOLE_TURN = 0.01
"""Relative distance from whole turns within which a jump of an angle is one (physical): an axis at 60 rad/s,
sampled at 1 kHz, moves by as much."""

JITTER = 0.01
LONGEST_SLIP = 20.0
"""Rows' motion up to which a jump may be rows that were lost where the stamps do not tell (empirical)."""
FEW_SLIPS = 5
MOSTLY = 0.9
"""Share of jumps that go the axis' way from which it is no chance: lost counts go either way, and five of
five the same way happen once in 32."""

_REACH = 4
_WEIGHTS = np.array([1.0, -8.0, 28.0, -56.0, 70.0, -56.0, 28.0, -8.0, 1.0]) / 70.0


def remove_glitches(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording with glitches interpolated and jumps undone, and a warning for each axis."""
    experiments, warnings = [], []
    for e in recording.experiments:
        position, told = _repair(e, recording)
        warnings += told
        experiments.append(e if position is None else replace(e, position=position))
    return (replace(recording, experiments=tuple(experiments)), warnings) if warnings else (recording, [])


def _repair(e: Experiment, recording: Recording) -> tuple[Float64 | None, list[str]]:
    """(n, M) position without them, ``None`` where there are none."""
    if e.samples < 4 * _REACH:
        return None, []
    steps = np.diff(e.time)
    even = np.abs(steps / np.median(steps) - 1.0) < 0.5
    position, descriptions = e.position.copy(), []
    unit = "m" if recording.linear else "rad"
    for i, axis in enumerate(recording.axes):
        own = position[:, i]
        jumps = np.diff(own)
        floor = LEAST_COUNTS * _smallest_count(jumps)
        again = np.concatenate(([False], (jumps == 0) & (np.diff(e.torque[:, i]) == 0)))  # dropped, not off
        is_even = np.concatenate(([True], even)) & np.concatenate((even, [True])) & ~again
        removed = np.zeros(own.size) if recording.linear else np.append(0.0, _whole_turns(jumps))
        at, size = find_isolated(jumps - removed[1:], even, floor)
        slips = _slips(jumps, at, size) if at.size and _jitters(steps) else np.zeros(at.size, dtype=np.bool_)
        if slips.sum() >= FEW_SLIPS and slips.mean() > MOSTLY:
            # Rows that were lost or stamped late move as the axis does: no encoder jumps so.
            descriptions.append(
                f"experiment {e.key}: {at.size} times axis {axis} goes on by one or more rows' motion at "
                "once: the stamps jitter, and rows are missing there or were taken late (a logger that was "
                "interrupted); log by the controller's own clock"
            )
            at, size = at[:0], size[:0]
        removed[at + 1] = size
        count = int(np.count_nonzero(removed))
        if count:
            own -= np.cumsum(removed)
            descriptions.append(
                f"experiment {e.key}: the position of axis {axis} jumps {_times(count)} within a sample, by "
                f"{np.abs(removed).max():.3g} {unit} at most, and goes on as before (a counter that wraps or "
                "loses counts: check the encoder's cable and the import); the jumps were taken back"
            )
        at, size = find_isolated(own, is_even, floor)
        if at.size:
            own[at] -= size
            samples = "1 sample stands" if at.size == 1 else f"{at.size} samples stand"
            descriptions.append(
                f"experiment {e.key}: {samples} off in the position of axis {axis}, each by itself and by "
                f"{np.abs(size).max():.3g} {unit} at most (glitches of encoder or bus: check cable and "
                "shield); interpolated"
            )
    return (position, descriptions) if descriptions else (None, [])


def _jitters(steps: Float64) -> bool:
    """Whether stamps of rows differ by more than a hundredth of a step: they do not tell a lost row."""
    middle = float(np.median(steps))
    return 1.4826 * float(np.median(np.abs(steps - middle))) > JITTER * middle


def _slips(jumps: Float64, at: Int64, size: Float64) -> Bool:
    """(k,) which jumps are the motion of one to ``LONGEST_SLIP`` rows, in its direction."""
    before = np.median([jumps[np.clip(at + o, 0, jumps.size - 1)] for o in (-3, -2, -1, 1, 2, 3)], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        rows = size / before
    return np.asarray((rows > 0.3) & (rows < LONGEST_SLIP), dtype=np.bool_)


def find_isolated(values: Float64, sound: Bool, floor: float) -> tuple[Int64, Float64]:
    """Places of values that stand off their neighbours by themselves, and how far.

    Parameters
    ----------
    values
        (n,) an evenly sampled series.
    sound
        (n,) where the sampling is even; nothing is found within four values of where it is not.
    floor
        Least distance.
    """
    none = np.zeros(0, dtype=int), np.zeros(0)
    if values.size < 4 * _REACH:
        return none
    deviation = np.convolve(values, _WEIGHTS, mode="valid")
    is_clear = np.convolve(~sound, np.ones(_WEIGHTS.size), mode="valid") < 0.5
    limit = max(LEAST_DEVIATION * 1.4826 * float(np.median(np.abs(deviation))), floor)
    picked = np.flatnonzero((np.abs(deviation) > limit) & is_clear)
    kept = []
    for k in picked.tolist():
        first, last = max(k - _REACH, 0), min(k + _REACH + 1, deviation.size)
        if np.abs(deviation[first:last]).max() > abs(deviation[k]):
            continue  # beside one that is off all are; the farthest of them is it
        rest = deviation[first:last] - deviation[k] * _WEIGHTS[first - k + _REACH : last - k + _REACH]
        if np.sqrt(float(rest @ rest) / (2 * _REACH)) < MOST_REMAINDER * abs(deviation[k]):
            kept.append(k)
    if not kept or len(kept) > MOST_SHARE * values.size:
        return none
    places = np.array(kept, dtype=int)
    return places + _REACH, deviation[places]


def _smallest_count(jumps: Float64) -> float:
    """Smallest difference between steps from sample to sample: the encoder's count, where it shows."""
    sizes = np.diff(np.unique(jumps))
    sizes = sizes[sizes > 1e-9 * np.ptp(jumps)]  # the same count, at two places, may differ by rounding
    return float(sizes.min()) if sizes.size else np.inf


def _whole_turns(jumps: Float64) -> Float64:
    """(n − 1,) whole turns [rad] within those jumps from sample to sample that are about that."""
    turns = np.round(jumps / (2 * np.pi)) * 2 * np.pi
    result: Float64 = np.where(np.abs(jumps - turns) < WHOLE_TURN * np.abs(turns), turns, 0.0)
    return result


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
