"""Noise covariance of averaged spectra: from the periods, or from lines that carry no signal."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Complex128, Float64


def pooled_covariance(deviations: Complex128, floor: Float64) -> Complex128:
    """(F, C, C) covariance of the mean over periods, pooled over neighbouring lines.

    Parameters
    ----------
    deviations
        (P, F, C) period spectra minus their mean over the periods.
    floor
        (C,) or (F, C) smallest believable noise power of one line of one period.

    Noise varies smoothly with frequency, so neighbours share one covariance: as many as give four
    complex degrees of freedom per channel pair's row (4·C), which keeps a C×C matrix well
    conditioned and the Hotelling inflation below 1.4.
    """
    periods, lines, channels = deviations.shape
    free = periods - 1
    half = int(np.ceil((4 * channels / free - 1) / 2))
    half = min(max(half, 2), (lines - 1) // 2 if lines > 2 else 0)
    outer = np.einsum("pfc,pfd->fcd", deviations, deviations.conj()) / free
    sums = np.concatenate((np.zeros((1, channels, channels), complex), np.cumsum(outer, axis=0)))
    low = np.clip(np.arange(lines) - half, 0, max(lines - 2 * half - 1, 0))
    high = np.minimum(low + 2 * half + 1, lines)
    covariance = (sums[high] - sums[low]) / (high - low)[:, None, None]
    diagonal = np.einsum("fcc->fc", covariance).real
    lift = np.maximum(floor - diagonal, 0.0)
    covariance = covariance + np.einsum("fc,cd->fcd", lift, np.eye(channels))
    pooled: Complex128 = covariance / periods
    return pooled


def flat_covariance(floor: Float64, lines: int) -> Complex128:
    """(F, C, C) diagonal covariance of noise of power ``floor``: (C,) the same on every line, or (F, C)."""
    power = np.broadcast_to(floor, (lines, floor.shape[-1]))
    result: Complex128 = (power[:, :, None] * np.eye(floor.shape[-1])).astype(np.complex128)
    return result


def quiet_power(spectrum: Complex128, quiet: np.ndarray) -> tuple[Float64, float]:
    """(C,) noise power a line of (F, C) spectra over the ``quiet`` lines, and its real dof.

    From the median, which a few signal lines among the quiet ones do not move: the power of complex
    noise is exponential, so its mean is the median over ln 2.
    """
    power = np.abs(spectrum[quiet]) ** 2
    if power.shape[0] == 0:
        return np.zeros(spectrum.shape[1]), 0.0
    level: Float64 = np.median(power, axis=0) / np.log(2.0)
    # The median of an exponential has 1/ln²2 times the variance of the mean.
    return level, 2.0 * power.shape[0] * float(np.log(2.0) ** 2)


def quantisation_step(values: Float64) -> Float64:
    """(C,) step of channels whose (n, C) values lie on a lattice; zero for the others.

    The smallest change between samples that differ; a lattice only if all changes are multiples of
    it to a part in a hundred (counts scaled to units are exact to rounding).
    """
    result = np.zeros(values.shape[1])
    for channel in range(values.shape[1]):
        change = np.abs(np.diff(values[:, channel]))
        rounding = 1e-9 * max(float(np.abs(values[:, channel]).max(initial=0.0)), 1e-300)
        change = change[change > rounding]
        if change.size == 0:
            continue
        step = float(change.min())
        ratio = change / step
        # Differences of thousands of counts carry the rounding of the scale: judge small ones.
        small = ratio[ratio < 50]
        if small.size > 3 and np.abs(small - np.round(small)).max() < 0.01:
            result[channel] = step
    return result
