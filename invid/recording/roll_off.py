"""The corner of a filter that a channel went through, by the noise that it has left.

A sensor's noise and its rounding are white. What differs from period to period of a periodic record is noise
alone, whatever was excited: where it is level over an octave and then falls as a low-pass does, down to the
rounding that came after it, one stands between the sensor and the file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.numerics.arrays import Float64
from invid.recording.clock import count_slots
from invid.recording.model import Experiment

LINES = 8
"""Least lines in a band: with eight periods its level is known to 0.7 dB; a corner below some
hundred lines is not seen."""
LEVEL = 3.0
"""Corner over the frequency from which the noise must be level: a friction that differs from period to period
falls from the first line on."""
LEVEL_DB = 2.0
"""Fall over its first octave from which it is not level: 1 dB up to a third of the corner, beyond it 6."""
FALL_DB = 6.0
"""Fall from which there is a filter; white noise scatters by a tenth of it."""
SHAPE_DB = 0.5
"""What a filter's curve may miss beside the scatter of the levels: sampling bends it (empirical: first to
fourth order from a 16th to two fifths of the sample rate)."""
MISFIT = 1.6
"""Rms of what is missed, over scatter and shape: twenty bands of a filter stay below it in 99.9 %."""
TOP = 0.7
"""Share of half the sample rate up to which sampling leaves a filter's curve as it is, to 2 dB."""
_ORDERS = np.arange(1, 5)
_FLOORS = np.append(0.0, 10.0 ** np.arange(-1.0, -7.0, -0.5))
"""What is left of the level: rounding after the filter."""


@dataclass(frozen=True)
class RollOff:
    """A low-pass seen in a channel's noise, which it has lowered by ``fall_db``."""

    corner_hz: float
    order: int
    fall_db: float


def roll_off(e: Experiment, values: Float64) -> RollOff | None:
    """The low-pass that (n,) values of a periodic experiment went through; ``None`` where none shows."""
    period = e.period_samples
    slots = count_slots(e.time) if period and values.size >= 4 * period else None
    if slots is None or not slots.even or slots.lost:
        return None
    count = values.size // period
    # The first period may hold a transient.
    blocks = values[values.size - count * period :].reshape(count, period)[1:]
    noise = blocks - blocks.mean(axis=0)
    if float(noise.std()) <= 0.3 * _lattice(values):
        return None  # rounding of a value that hardly changes is not white
    power = np.sum(np.abs(np.fft.rfft(noise, axis=1)) ** 2, axis=0)
    return _fitted(*_bands(power, 1.0 / (period * slots.step), count - 2))


def low_passed_axes(experiments: Sequence[Experiment]) -> tuple[int, ...]:
    """Axes whose torque went through a low-pass in any of the experiments."""
    axes = range(experiments[0].torque.shape[1]) if experiments else ()
    return tuple(m for m in axes if any(roll_off(e, e.torque[:, m]) is not None for e in experiments))


def _lattice(values: Float64) -> float:
    change = np.abs(np.diff(values))
    change = change[change > 1e-9 * max(float(np.abs(values).max()), 1e-300)]
    return float(change.min()) if change.size else np.inf


def _bands(power: Float64, line_hz: float, free: int) -> tuple[Float64, Float64, Float64]:
    """Middles [Hz], levels and their deviations [dB] of third octaves from the top down.

    Medians, which no line excited moves; of values with 2 · ``free`` real degrees of freedom.
    """
    narrow = 2.0 ** (-1.0 / 3.0)
    edge, f, level, std = TOP * (power.size - 1), [], [], []
    while edge * (1.0 - narrow) >= LINES:
        inside = power[int(np.ceil(edge * narrow)) : int(np.ceil(edge))]
        f.append(edge * np.sqrt(narrow) * line_hz)
        level.append(10 * np.log10(max(float(np.median(inside)), 1e-300)))
        std.append(10 / np.log(10) * 1.25 / np.sqrt(free * inside.size))
        edge *= narrow
    return np.array(f[::-1]), np.array(level[::-1]), np.array(std[::-1])


def _fitted(f: Float64, level: Float64, std: Float64) -> RollOff | None:
    """The low-pass over a floor that the levels follow best from their first level octave on."""
    for first in range(max(f.size - 6, 0)):
        x, y, scale = f[first:], level[first:], np.hypot(std[first:], SHAPE_DB)
        if y[0] - y[3] > LEVEL_DB:
            continue
        corners = np.geomspace(LEVEL * x[0], x[-1], 3 * x.size)
        passed = 1.0 / (1.0 + (x / corners[:, None, None]) ** (2 * _ORDERS[:, None]))
        curves = 10 * np.log10(passed[:, :, None] + _FLOORS[:, None])
        rest = (y - curves) / scale
        rest -= (rest / scale).sum(axis=-1, keepdims=True) / (1 / scale**2).sum() / scale
        misfit = np.sqrt(np.mean(rest**2, axis=-1))
        best = np.unravel_index(int(np.argmin(misfit)), misfit.shape)
        fall = float(curves[best][0] - curves[best][-1])
        if misfit[best] < MISFIT and fall > FALL_DB:
            return RollOff(float(corners[best[0]]), int(_ORDERS[best[1]]), fall)
    return None


__all__ = ["RollOff", "roll_off"]
