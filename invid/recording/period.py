"""The period of a signal, from the signal alone."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Float64

_LONGEST = 1 << 20
"""Samples that are looked at for a period: four of a minute at 4 kHz."""


def find_period(values: Float64, *, repeats: int = 4) -> int:
    """Samples after which a signal repeats at least so often; 0 where it does not.

    Candidates come from the autocorrelation. A candidate stands where the mean over periods explains
    98 % of the power. That bound is empirical: a measured multisine with 5 % noise reaches 99.7 %; moves
    repeated under closed loop with friction reach 95 %, and are not periodic in the sense of spectra.
    """
    n = min(values.size, _LONGEST)
    if n < 64:
        return 0
    x = values[:n] - values[:n].mean()
    power = float(np.mean(x**2))
    if power <= 0:
        return 0
    spectrum = np.fft.rfft(x, 1 << (2 * n - 1).bit_length())
    half = n // repeats + 1
    lags = np.fft.irfft(spectrum * spectrum.conj())[:half] / (n - np.arange(half)) / power
    below = np.flatnonzero(lags < 0.2)
    if below.size == 0 or int(below[0]) >= half - 1:
        return 0
    start = int(below[0])
    peaks = [start + int(i) for i in np.flatnonzero(lags[start:] > lags[start:].max() - 0.02)]
    for period in peaks[:20]:
        count = n // period
        blocks = x[n - count * period :].reshape(count, period)[count // 4 :]
        if np.mean((blocks - blocks.mean(axis=0)) ** 2) < 0.02 * power:
            return period
    return 0
