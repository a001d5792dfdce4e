"""Noise of spectra: from the periods, from lines that carry no signal, from loops, and from rounding.

Rounding of a motion of many counts a sample is white: q²/12 over all frequencies. An axis that is held
moves a few counts in many samples; the same q²/12 then lies mostly within the band of the motion, ten and
more times the white density, repeats with the motion, and the quiet lines above do not show it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from invid.numerics.arrays import Bool, Complex128, Float64
from invid.numerics.linear_algebra import least_squares, real_rows


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


def repeating_power(mean: Complex128, quiet: Bool) -> float:
    """Noise power a line of the mean over periods (F,), on the odd or on the even lines of those that are
    ``quiet``, where there is more; zero where they are too few to tell.

    Quantisation of a motion that repeats, repeats. Odd lines alone give half-wave symmetric motion, whose
    errors lie on odd lines. What of a transient is left leaks smoothly over the quiet lines: second
    differences between lines of a parity, of six times the noise's power, do not see it.
    """
    powers = [0.0]
    for first in (0, 1):
        at = np.flatnonzero(quiet[first::2])
        lines = mean[first::2][at[0] : at[-1] + 1] if at.size else mean[:0]
        if lines.size > 2:
            powers.append(float(np.median(np.abs(np.diff(lines, 2)) ** 2)) / (6.0 * float(np.log(2.0))))
    return max(powers)


WINDOWS_PER_OCTAVE, LEAST_LINES = 4, 64
"""Width of the windows in which noise is looked at, and the least number of lines in one: their medians then
scatter by a fifth."""
FALLS = (4.0, 8.0)
"""Factor by which the power of lines that show motion falls in an octave, at least; the second where none
falls by less than the first. Physical: a torque on an inertia moves it with the second power of the period,
sixteen in power; an error of the encoder or a white noise does not fall, and behind a filter of first order a
noise falls by four; half way between, each."""


@dataclass(frozen=True)
class NoisePlateau:
    """Noise ``level`` of one line above the motion's band, its real ``dof``, and where it was read [Hz].

    Beyond ``high`` a filter, or the fastest passage of an encoder's lines, leaves less of it.
    """

    level: float
    dof: float
    low: float
    high: float

    def lines(self, hz: Float64) -> Bool:
        """(F,) the lines on the plateau."""
        inside: Bool = (hz >= self.low) & (hz <= self.high)
        return inside


def noise_plateau(power: Float64, hz: Float64) -> NoisePlateau:
    """The noise nearest above the band of the motion, from the power (F,) of quiet lines at ``hz`` (F,); the
    median of all where they reach over less than an octave.

    The median over all lines up to half the sampling rate is right for white noise alone. An encoder's error
    within its lines reaches as far as the lines pass in a second, a filter's noise to its corner: the band
    sees their level, forty and more times the median. Motion falls off steeply, so the noise begins where the
    levels fall no more, and goes on while they stay above half of that.
    """
    edges, at = [0], 0
    while at < power.size:
        end = int(np.searchsorted(hz, hz[at] * 2.0 ** (1.0 / WINDOWS_PER_OCTAVE)))
        at = max(end, at + LEAST_LINES)
        edges.append(at if power.size - at >= LEAST_LINES else power.size)
        at = edges[-1]
    levels = np.array([np.median(power[a:b]) for a, b in pairwise(edges)]) / np.log(2.0)
    middle = np.array([np.sqrt(hz[a] * hz[b - 1]) for a, b in pairwise(edges)])
    higher = np.searchsorted(middle, 2.0 * middle)
    seen = np.flatnonzero(higher < levels.size)  # windows with another one an octave above
    if not seen.size:
        whole, dof = quiet_power(np.sqrt(power)[:, None], np.ones(power.size, dtype=bool))
        low, high = (float(hz[0]), float(hz[-1])) if hz.size else (0.0, 0.0)
        return NoisePlateau(float(whole[0]), dof, low, high)
    above, last = higher[seen], levels.size - 1
    falls = levels[seen] / np.maximum(levels[above], 1e-300)
    falls **= 1.0 / np.log2(middle[above] / middle[seen])
    flat = next((int(seen[k]) for least in FALLS for k in np.flatnonzero(falls < least)), last)
    # Half an octave on: in the first such window there still is motion.
    first = min(int(np.searchsorted(middle, np.sqrt(2.0) * middle[flat])), last)
    end = first
    while end < last and levels[end + 1] > 0.5 * levels[first]:
        end += 1
    rows = slice(edges[first], edges[end + 1])
    level = float(np.median(power[rows])) / float(np.log(2.0))
    dof = 2.0 * (rows.stop - rows.start) * float(np.log(2.0) ** 2)
    return NoisePlateau(level, dof, float(hz[rows.start]), float(hz[rows.stop - 1]))


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


TAPS = 6
"""Samples of the reading that a command may follow: a position and a speed, up to four cycles late."""
ENOUGH = 20_000
"""Lines that are looked at, of long records evenly among all: they tell the share to one per cent."""
LOUD = 10.0
"""Power over that of the quiet lines beyond which one carries a signal: 1 in 20 000 of pure noise does."""


def sensor_noise_share(spectra: Complex128, hz: Float64, step: float) -> Float64:
    """(2M,) share of each channel on the quiet lines that is its sensor's noise: all of a reading, and of a
    torque what does not follow from the axis' own reading.

    ``spectra`` (P, F, 2M) [rad or m, N·m or N] of the quiet lines alone, ``hz`` (F,), ``step`` [s]. What a
    hold or a position loop commands of the noise on its reading is logged as it acts. The missing torque
    r = Z(Θ + n) − T then holds Z n and nothing of T; taken for a sensor's noise it put the floor of empty
    records two to five times too high. One where too few lines are left to tell.
    """
    every = max(spectra.shape[0] * spectra.shape[1] // ENOUGH, 1)
    spectra, hz = spectra[:, ::every], hz[::every]
    motors = spectra.shape[2] // 2
    out = np.ones(2 * motors)
    turn = np.exp(-2j * np.pi * hz * step)[:, None] ** np.arange(TAPS)
    for i in range(motors):
        reading, torque = spectra[:, :, i], spectra[:, :, motors + i]
        quiet = _quiet(reading) & _quiet(torque)
        level = float(np.median(np.abs(torque) ** 2)) if torque.size else 0.0
        if quiet.sum() < 10 * TAPS or level <= 0.0:
            continue
        taps = reading[..., None] * turn
        rows, target = taps[quiet], torque[quiet]
        if not np.any(rows, axis=0).all():
            continue
        rest = torque - taps @ least_squares(real_rows(rows), real_rows(target), rcond=1e-10)
        freedom = 1.0 - TAPS / (2.0 * quiet.sum())
        out[motors + i] = min(float(np.median(np.abs(rest[quiet]) ** 2)) / freedom / level, 1.0)
    return out


def _quiet(lines: Complex128) -> np.ndarray:
    power = np.abs(lines) ** 2
    quiet: np.ndarray = power <= LOUD * np.median(power) / np.log(2.0)
    return quiet


def rounding_power(single: Float64, mean: Float64, step: Float64, top: int) -> Float64:
    """Power of the rounding error on the lines within the band of the motion.

    A motion without content above ``top`` leaves there nothing but its rounding (and noise). What of the
    whole q²/12 is not seen there lies below, where it cannot be told from motion; it is spread evenly, and
    over odd and even lines as it is above (a half-wave symmetric motion has its rounding on odd lines).

    Parameters
    ----------
    single
        (L, C) mean square amplitude of lines 1…L (to the Nyquist frequency) of one period [unit²].
    mean
        (L, C) square amplitude of the average over the periods: what does not repeat is less there.
    step
        (C,) lattice q of each channel, 0 for none [unit].
    top
        Lines 1…top are the band of the motion.

    Returns
    -------
    (top, C) mean square amplitude of the averaged lines [unit²]; zero for channels without lattice, and for
    those with so much noise above the band that it hides q²/12: their quiet lines tell all.
    """
    # Σ|X_k|²/2 over all lines is the variance.
    above = single[top:].sum(axis=0)
    within = np.maximum(2.0 * step**2 / 12.0 - above, 0.0)
    averaged = mean[top:].sum(axis=0)
    kept = np.where(above > 0, averaged / np.maximum(above, 1e-300), 1.0)
    power = np.zeros((top, single.shape[1]))
    # Line k has index k − 1.
    for parity in (0, 1):
        outside = mean[top + (parity - top) % 2 :: 2].sum(axis=0)
        share = np.where(averaged > 0, outside / np.maximum(averaged, 1e-300), 0.5)
        lines = power[parity::2].shape[0]
        if lines:
            power[parity::2] = kept * share * within / lines
    return power
