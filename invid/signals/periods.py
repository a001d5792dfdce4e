"""Periods of a periodic record: check of the declared period, and the first settled period."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.numerics.arrays import Bool, Complex128, Float64
from invid.numerics.distributions import f_isf

FALSE_DROP = 1e-4
"""Chance of dropping a settled period. Small because a dropped period costs information and a test
with hundreds of lines sees a transient of a tenth of the noise anyway."""


def fold(values: Float64, period: int) -> Float64:
    """(P, period, M) whole periods counted from the end of (n, M) values."""
    periods = values.shape[0] // period
    return values[values.shape[0] - periods * period :].reshape(periods, period, values.shape[1])


def remove_drift(folded: Float64) -> Float64:
    """(P, n, M) positions without the straight line through the period means.

    A free axis coasts; a straight line leaks onto every line alike in every period, so averaging
    does not remove it.
    """
    periods, samples, _ = folded.shape
    if periods < 2:
        return folded
    means = folded.mean(axis=1)
    index = np.arange(periods) - (periods - 1) / 2
    slope = (index[:, None] * means).sum(0) / (index**2).sum() / samples
    time = np.arange(periods * samples) - (periods * samples - 1) / 2
    line, result = time.reshape(periods, samples), folded.copy()
    for axis in range(slope.size):  # one by one: of long records each copy counts
        result[..., axis] -= line * slope[axis]
    return result


def nonrepeating_share(folded: Float64) -> Float64:
    """(M,) share of the variance that does not repeat from one period to the next (0 … about 1)."""
    if folded.shape[0] < 2:
        return np.zeros(folded.shape[2])
    change = np.diff(folded, axis=0)
    change = change - change.mean(axis=1, keepdims=True)
    within = folded - folded.mean(axis=1, keepdims=True)
    share: Float64 = (change**2).mean(axis=(0, 1)) / 2 / np.maximum((within**2).mean(axis=(0, 1)), 1e-300)
    return share


def find_period(values: Float64, longest: int) -> int | None:
    """Period in samples of the strongest repetition of (n,) values, or ``None``.

    Smallest lag at which the normalised autocorrelation is within 1 % of perfect.
    """
    centred = values - values.mean()
    count = centred.size
    size = 1 << (2 * count - 1).bit_length()
    spectrum = np.fft.rfft(centred, size)
    correlation = np.fft.irfft(np.abs(spectrum) ** 2, size)[: longest + 1]
    power = np.concatenate(([0.0], np.cumsum(centred**2)))
    lags = np.arange(longest + 1)
    norm = np.sqrt(power[count - lags] * (power[count] - power[lags]))
    normal = correlation / np.maximum(norm, 1e-300)
    # Leave the first peak (lag zero) before looking for another.
    left = np.flatnonzero(normal < 0.5)
    if left.size == 0:
        return None
    candidates = np.flatnonzero(normal[left[0] :] > 0.99) + left[0]
    if candidates.size == 0:
        return None
    run = candidates[candidates < candidates[0] * 1.05 + 2]
    return int(run[np.argmax(normal[run])])


CHANGE_GROWTH = 10.0
"""Growth in power of the differences of neighbouring periods that no settling shows. Empirical: noise on
forty lines and more stays below two, a load put on was 10⁵ and 60 times."""


@dataclass(frozen=True)
class Settling:
    """Which periods to use."""

    first: int
    """First period used."""
    settled: bool
    """False where even the last periods still differ by more than noise."""


def find_settled_periods(
    spectra: Complex128, floor: Float64, floor_dof: float, excited: Bool | None = None
) -> Settling:
    """First period after which the spectra of the periods differ by noise only.

    Parameters
    ----------
    spectra
        (P, F, C) period spectra of C channels.
    floor
        (C,) noise power of one line of one period, from lines above the band.
    floor_dof
        Real degrees of freedom of ``floor``.
    excited
        (F,) lines that the excitation drives, where they are known; all else.

    Each period is compared with the mean of those after it, on the excited lines: where nothing is driven a
    slow drift differs in every period. The yardstick is the scatter of the later periods among themselves
    where there are two or more, and the floor from above the band otherwise; the ratio is F distributed for
    noise. Two periods in a row that differ end the count; one alone, with one before it that does not, is
    scatter. Where even the last two differ by more than the floor on all lines, the record is called not
    settled: the fit then carries the boundary terms, which are exact for any transient.
    """
    periods, lines, _ = spectra.shape
    if periods == 1:
        return Settling(0, False)
    # Power of what neighbours differ by; noise alone stays below the limit.
    last = (np.abs(spectra[-1] - spectra[-2]) ** 2).mean(0) / 2 / np.maximum(floor, 1e-300)
    settled = bool(np.all(last <= _largest_noise_ratio(lines, floor_dof)))
    if excited is not None:
        spectra, lines = spectra[:, excited], int(excited.sum())
    steps = (np.abs(np.diff(spectra, axis=0)) ** 2).mean(1) / 2 / np.maximum(floor, 1e-300)
    used, differing = periods - 2, 0
    for first in range(periods - 3, -1, -1):
        following = spectra[first + 1 :]
        count = following.shape[0]
        power = (np.abs(spectra[first] - following.mean(0)) ** 2 / (1 + 1 / count)).mean(0)
        scatter = (np.abs(following - following.mean(0)) ** 2).sum(0).mean(0) / (count - 1)
        # Quantised channels can repeat exactly: the floor from above keeps the ratio finite.
        reference = np.maximum(np.maximum(scatter, floor), 1e-300)
        if np.all(power <= _largest_noise_ratio(lines, 2.0 * lines * (count - 1)) * reference):
            used, differing = first, 0
            continue
        differing += 1
        if differing == 2:
            break
    limit = _largest_noise_ratio(lines, floor_dof)
    return Settling(_first_before_change(steps[: used + 1], limit), settled)


def _first_before_change(steps: Float64, limit: float) -> int:
    """First period used of those with ``steps`` (used + 1, C) to the next; earlier where the machine changed.

    Settling is largest at first. Neighbours that differ ten times more in power than those before them are a
    machine that changed, whose first load would be dropped with the periods before.
    """
    used = len(steps) - 1
    for k in range(1, used):
        if np.any(steps[k] > CHANGE_GROWTH * np.maximum(steps[:k].max(axis=0), limit)):
            alike = np.flatnonzero((steps[:k] <= limit).all(axis=1))
            return int(alike[0]) if alike.size else 0
    return used


def _largest_noise_ratio(lines: int, dof: float) -> float:
    """Largest power ratio that noise explains.

    The F quantile with an empirical margin of 2: coloured noise and stick-slip make the scatter of few
    periods uneven over lines, and a transient below twice the noise in power moves a mean over the periods by
    less than its own standard deviation.
    """
    return 2.0 * f_isf(FALSE_DROP, 2 * lines, max(dof, 2.0))
