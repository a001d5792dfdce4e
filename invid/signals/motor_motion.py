"""Motion of the motors over time, as laws of friction need it: noise filtered out, between the samples too.

A record that does not close is differentiated without the polynomial that joins its ends in value, slope and
curvature. A jump of the slope alone leaves lines that fall off with the second power of frequency only: over
the band they hide in the noise, in the velocity they are errors of per cents near the ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.numerics.arrays import Complex128, Float64

END_SPAN, END_ORDER = 0.4, 3
"""Length of the ends over the period of the highest line in use, and the order of their polynomials: what
they miss of that line is below a hundredth of it."""


@dataclass(frozen=True, eq=False)
class MotorMotion:
    """Motion of the motors on a grid over a record.

    ``position``, ``velocity`` (n, M); ``noise`` (M,) standard deviation of the velocity; ``unseen``
    (n//2 + 1, M) share of each line above the band that was taken for noise.
    """

    position: Float64
    velocity: Float64
    noise: Float64
    unseen: Float64


def motor_motion(
    wave: Float64, step: float, floor: Float64, top: int, grid: int, *, closes: bool
) -> MotorMotion:
    """Motion of the motors on ``grid`` points over a record.

    Parameters
    ----------
    wave
        (N, M) measured positions.
    step
        Their interval [s].
    floor
        (M,) noise power of one line (of amplitudes).
    top
        Number of the highest line in use.
    closes
        Whether the first sample follows on the last.
    """
    count, motors = wave.shape
    span = count * step
    jumps = np.zeros((3, motors)) if closes else _end_jumps(wave, step, max(span / max(top, 1), 8 * step))
    at = _joining(((np.arange(count) + 0.5) / count - 0.5)[:, None], jumps, span)[0]
    spectrum = np.fft.rfft(wave - at, axis=0)
    omega = 2 * np.pi / span * np.arange(spectrum.shape[0])[:, None]
    noise, power = floor * (count / 2.0) ** 2, np.abs(spectrum) ** 2
    # In the band lines within six times the noise power are taken for noise (1 in 400 of pure noise passes);
    # beyond it, where a velocity multiplies it, those within a level that one record in ten has a line above.
    beyond = np.arange(spectrum.shape[0])[:, None] > top
    level = np.where(beyond, np.log(10.0 * spectrum.shape[0]), 6.0)
    keep = np.where(power > level * noise, 1.0 - noise / np.maximum(power, 1e-300), 0.0)
    keep[0] = 1.0
    bins = grid // 2 + 1
    clean, seen = np.zeros((bins, motors), dtype=complex), np.zeros((bins, motors))
    own = min(bins, spectrum.shape[0])  # what lies beyond the samples' lines is not seen
    clean[:own], seen[:own] = (spectrum * keep)[:own] * (grid / count), keep[:own]
    unseen = np.where(np.arange(bins)[:, None] > top, 1.0 - seen, 0.0)
    if grid % 2 == 0:
        clean[-1] = unseen[-1] = 0.0
    # The first point of the grid is the first sample.
    join, slope = _joining((np.arange(grid) / grid + 0.5 / count - 0.5)[:, None], jumps, span)
    rate: Complex128 = 2j * np.pi / span * np.arange(bins)[:, None] * clean
    left = (omega**2 * noise * (keep > 0))[:bins].sum(axis=0) * 2 / count**2
    return MotorMotion(
        np.fft.irfft(clean, grid, axis=0) + join,
        np.fft.irfft(rate, grid, axis=0) + slope,
        np.sqrt(left),
        unseen,
    )


def _end_jumps(wave: Float64, step: float, period: float) -> Float64:
    """(3, M) jumps of value, slope and curvature from the end of a wave (N, M) to its start, in time [s]."""
    size = int(np.clip(END_SPAN * period / step, 2 * END_ORDER + 1, max(wave.shape[0] // 2, END_ORDER + 1)))
    order = min(END_ORDER, size - 1)
    # Half a sample before the first and after the last: the two meet there.
    before = np.arange(size) + 0.5
    powers = np.vander(before / size, order + 1, increasing=True)
    scale = np.array([1.0, 1.0 / (size * step), 2.0 / (size * step) ** 2])[: order + 1, None]
    signs = np.array([1.0, -1.0, 1.0])[: order + 1, None]
    start = np.linalg.lstsq(powers, wave[:size], rcond=None)[0][:3] * scale
    end = np.linalg.lstsq(powers, wave[::-1][:size], rcond=None)[0][:3] * scale * signs
    out = np.zeros((3, wave.shape[1]))
    out[: start.shape[0]] = end - start
    return out


def _joining(tau: Float64, jumps: Float64, span: float) -> tuple[Float64, Float64]:
    """(n, M) polynomial with given jumps (3, M) between its ends, and its slope, at ``tau`` (n, 1) from −½
    to ½.

    Bernoulli's polynomials: each has one jump.
    """
    value = jumps[0] * tau
    value = value + jumps[1] * span * (tau**2 / 2 - 1 / 24) + jumps[2] * span**2 * (tau**3 / 6 - tau / 24)
    slope = jumps[0] / span + jumps[1] * tau + jumps[2] * span * (tau**2 / 2 - 1 / 24)
    return value, slope


__all__ = ["MotorMotion", "motor_motion"]
