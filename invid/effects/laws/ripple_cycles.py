"""Candidates for cycles a revolution: a ripple over position is a line in the spectrum over position."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from invid.effects.motion import View, rms
from invid.model.place import Pattern
from invid.numerics.arrays import Float64

LEAST_PHASE = 4.0
"""Phase [rad, rms] up to which cycles are tried one by one (physical): a ripple whose phase hardly turns
looks like any other smooth force of position, and only the screen tells them apart. Beyond it the ripple is a
line."""
MOST_PEAKS = 3
"""Lines of the spectrum over position that are tried (empirical: the ripple is rarely below the third)."""
SLOW = 10.0
"""Rms speed over the slowest that still shows a ripple in the band (empirical): every motor turns round, and
slow parts alone show many cycles."""
BINS = 1 << 18
"""Most bins of position; for a motion that needs more, the highest cycles are not searched."""
MOST_CYCLES = 2000.0


def cycle_grid(size: float, most: int = 12) -> list[float]:
    """Cycles a revolution to try for a motion of rms ``size`` [rad]: 0.4 to 4 rad of phase."""
    low, high = max(1.5, 0.4 / max(size, 1e-9)), max(3.0, LEAST_PHASE / max(size, 1e-9))
    values = np.geomspace(low, max(high, 1.2 * low), most)
    return sorted({float(v) for v in values})


def ripples(views: Sequence[View], coordinate: Pattern, force: Pattern) -> list[float]:
    """Cycles a revolution of the strongest ripples of ``force`` over the position ``coordinate``, ascending.

    The force estimated from the missing torque is summed over position and transformed; of each peak beyond
    ``LEAST_PHASE`` the neighbours up to a line away are returned with it, because the part of the ripple that
    the linear fit absorbed shifts it. Empty where no force can be estimated or the motion is small.
    """
    readable = [(v, v.wave(coordinate), v.remaining) for v in views if v.remaining is not None]
    angles = [angle for _, angle, _ in readable]
    size = rms(angles)
    speed = rms([v.velocity(coordinate) for v, *_ in readable])
    if size <= 0 or speed <= 0:
        return []
    low = min(float(a.min()) for a in angles)
    span = max(float(a.max()) for a in angles) - low
    top = min(MOST_CYCLES, SLOW * max(float(v.omega[-1]) for v, *_ in readable) / speed)
    if span <= 0 or top <= LEAST_PHASE / size:
        return []
    width = max(2 * np.pi / (8.0 * top), span / BINS)
    bins = int(span / width) + 1
    length = scipy.fft.next_fast_len(4 * bins, real=True)
    power = np.zeros(length // 2 + 1)
    for view, angle, remaining in readable:
        lines = view.distributed_force(force, remaining)
        lines[0] = 0.0
        wave = view.record.to_wave(lines)
        force_over_position = np.bincount(((angle - low) / width).astype(int), weights=wave, minlength=bins)
        power += np.abs(np.fft.rfft(force_over_position, length)) ** 2 / view.record.samples
    cycles = 2 * np.pi * np.arange(power.size) / (length * width)
    return _cycles_of_peaks(cycles, power, LEAST_PHASE / size, min(top, np.pi / width), np.pi / span)


def _cycles_of_peaks(
    cycles: Float64, power: Float64, low: float, high: float, half_line: float
) -> list[float]:
    inside = np.flatnonzero((cycles > low) & (cycles < high))
    inside = inside[(inside > 0) & (inside < power.size - 1)]
    summit = inside[(power[inside] >= power[inside - 1]) & (power[inside] > power[inside + 1])]
    best = summit[np.argsort(-power[summit])][:MOST_PEAKS]
    around = cycles[best][:, None] + half_line * np.arange(-2, 3)
    return sorted({float(c) for c in around.ravel() if low < c < MOST_CYCLES})


def rotate_phase(amplitude: float, phase: float) -> tuple[float, float]:
    """a·sin(x + φ) as (a·cos φ)·sin x + (a·sin φ)·cos x."""
    return float(amplitude * np.cos(phase)), float(amplitude * np.sin(phase))
