"""The hold that works while an axis is driven, identified from its command, which is smooth over
frequency."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from invid.numerics.arrays import Complex128, Float64
from invid.numerics.distributions import f_isf
from invid.numerics.linear_algebra import real_rows
from invid.signals.spectra import LineSpectra

CHANCE = 1e-6
"""Probability of taking a hold for seen where there is none. Small: a command of random amplitudes is rough
with and without it, and of many lines some hold always smooths a little."""
ROUGHNESS_RATIO = 4.0
"""Factor by which the roughness (mean square) must fall as well (empirical): half in amplitude."""
MOST_ROUGHNESS = 0.35
"""Root mean square of the second differences of log amplitude above which a command is not smooth: lines
whose noise is below a fifth of their amplitude (``SIGNAL_POWER``) have at most √6/5/√2."""
SIGNAL_POWER = 25.0
"""Power over noise of a line that counts."""
MOST_RESIDUAL = 2.0
"""Mean square of what a hold leaves on lines without a command, in units of the noise: 16 lines and more of
pure noise exceed it once in two thousand."""
LEAST_LINES = 16
"""Lines needed at least."""
DAMPING_STARTS = (0.03, 0.3, 3.0)
"""Dampings P/(ωD) at the middle of the band from which the search starts."""

RecordLines = tuple[Complex128, Complex128, Complex128, Float64]
"""Position, velocity, torque and angular frequency of the lines of a record."""


def find_smooth_hold(spectra: Sequence[LineSpectra], axis: int) -> tuple[float, float] | None:
    """Gains (P, D) of a hold −(P + jωD)θ within the recorded torque of a driven axis; ``None``: none seen.

    The recorded torque T holds the command and the hold's part. Commands of shaking are designed: their
    amplitude is smooth over frequency, while T alone has the machine's resonances. The hold is that which
    makes |T + (P + jωD)Θ| smoothest. Where the lines are shared out among the axes (interleaved), an axis'
    torque on the lines of the others is its hold's alone.
    """
    by_lines = _without_command(spectra, axis)
    if by_lines is not None:
        return by_lines
    parts = []
    for s in spectra:
        lines = np.flatnonzero(s.excited)
        if s.driven[axis] and lines.size >= LEAST_LINES:
            noise = s.floor[s.axis_count + axis]
            has_signal = lines[np.abs(s.torque[lines, axis]) ** 2 > SIGNAL_POWER * noise]
            if has_signal.size > 0.8 * lines.size:
                speed = 1j * s.omega[lines] * s.position[lines, axis] + _end_spectrum(s, axis)
                parts.append((s.position[lines, axis], speed, s.torque[lines, axis], s.omega[lines]))
    if not parts:
        return None
    count = sum(q.size - 2 for q, *_ in parts)
    without = _roughness(parts, np.zeros(2))
    stiffness = np.concatenate([np.abs(t) / np.maximum(np.abs(q), 1e-300) for q, _, t, _ in parts])
    omega = np.concatenate([np.abs(v) / np.maximum(np.abs(q), 1e-300) for q, v, *_ in parts])
    best = without
    law = np.zeros(2)
    for size in np.quantile(stiffness, (0.05, 0.25, 0.5)):
        for share in DAMPING_STARTS:
            begun = np.array([size * min(share, 1.0), size * min(1.0 / share, 1.0) / np.median(omega)])
            found = np.exp(
                scipy.optimize.least_squares(lambda x: _roughness(parts, np.exp(x)), np.log(begun)).x
            )
            roughness = _roughness(parts, found)
            if roughness @ roughness < best @ best:
                best, law = roughness, found
    before, after = float(without @ without), float(best @ best)
    if not np.all(law >= 0) or law[0] <= 0:
        return None
    if after > MOST_ROUGHNESS**2 * count:
        return None
    if before < ROUGHNESS_RATIO * after or (before - after) / 2.0 < f_isf(CHANCE, 2, count) * after / count:
        return None
    return float(law[0]), float(law[1])


def _without_command(spectra: Sequence[LineSpectra], axis: int) -> tuple[float, float] | None:
    """The hold from every k-th excited line, where it explains the torque on those to the noise."""
    for s in spectra:
        excited = np.flatnonzero(s.excited)
        if not s.driven[axis]:
            continue
        noise = s.floor[[axis, s.axis_count + axis]]
        for stride in range(2, s.axis_count + 1):
            for first in range(stride):
                lines = excited[first::stride]
                torque, theta = s.torque[lines, axis], s.position[lines, axis]
                if lines.size < LEAST_LINES or np.mean(np.abs(torque) ** 2) < SIGNAL_POWER * noise[1]:
                    continue
                rows = -np.stack((theta, 1j * s.omega[lines] * theta + _end_spectrum(s, axis)), axis=1)
                law = np.linalg.lstsq(real_rows(rows), real_rows(torque), rcond=None)[0]
                gain = law[0] ** 2 + (s.omega[lines] * law[1]) ** 2
                left = np.abs(torque - rows @ law) ** 2 / (noise[1] + gain * noise[0])
                if np.all(law >= 0) and law[0] > 0 and np.mean(left) < MOST_RESIDUAL:
                    return float(law[0]), float(law[1])
    return None


def _end_spectrum(s: LineSpectra, axis: int) -> float:
    """Contribution of the ends of a record that does not close to the spectrum of its velocity."""
    if not (s.transient and s.periods == 1):
        return 0.0
    wave = s.position_wave[:, axis]
    return float(2.0 * (2.0 * wave[-1] - wave[-2] - wave[0]) / s.span_s)


def _roughness(parts: Sequence[RecordLines], law: Float64) -> Float64:
    """Second differences of log |T + PΘ + DΩ| between neighbouring lines, corrected for uneven log frequency.

    Commands often fall with a power of frequency. Second differences over the lines alone take that for
    roughness, most at the lowest lines, which determine P: it came out 2.6 times too large.
    """
    out = []
    for position, speed, torque, omega in parts:
        size = np.log(np.maximum(np.abs(torque + law[0] * position + law[1] * speed), 1e-300))
        at = np.log(omega)
        share = (at[1:-1] - at[:-2]) / (at[2:] - at[:-2])
        out.append(2.0 * ((1.0 - share) * size[:-2] + share * size[2:] - size[1:-1]))
    result: Float64 = np.concatenate(out)
    return result
