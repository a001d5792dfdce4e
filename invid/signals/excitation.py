"""Excitation as data: what torque (or path) a motor is given at each cycle.

Everything is a pure function of its arguments; chance comes in as a Generator. Torque in N·m (N),
frequencies in Hz, one row a SYNC cycle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from invid.errors import InputError
from invid.numerics.arrays import Float64, Int64, frozen_float


@dataclass(frozen=True, eq=False)
class Multisine:
    """A sum of cosines on the lines k·f0 of one period.

    Attributes
    ----------
    lines
        (L,) line numbers k.
    amplitudes, phases
        (L,) cosine amplitudes, scaled to a peak of 1 over the rotations it was designed for, and
        phases [rad].
    period_samples
        Samples in one period.
    sample_rate
        Cycles per second [Hz].
    """

    lines: Int64
    amplitudes: Float64
    phases: Float64
    period_samples: int
    sample_rate: float

    def period(self, rotation: float = 0.0) -> Float64:
        """(period_samples,) one period, every line turned by ``rotation`` [rad]."""
        spectrum = np.zeros(self.period_samples // 2 + 1, dtype=complex)
        values = self.amplitudes * np.exp(1j * (self.phases + rotation))
        spectrum[self.lines] = values * (self.period_samples / 2)
        samples: Float64 = np.fft.irfft(spectrum, n=self.period_samples)
        return samples


DRAWS, ITERATIONS = 24, 400
"""Random phase sets of a multisine, and clippings of the best. Empirical (every third line of 0.5 to 12 Hz):
60 leave a crest factor 12 % higher, a thousand take 3 % off."""


def line_numbers(
    period_s: float,
    band: tuple[float, float],
    kind: str,
    *,
    detection_fraction: float,
    rng: np.random.Generator,
) -> Int64:
    """(L,) lines in the band: ``odd`` ones less a random share kept free for detection, or ``all``.

    Odd lines keep even distortion off the excited lines; the free odd lines show odd distortion. The
    free ones are drawn one from each group of neighbours, so that none of the band goes unexcited.
    """
    first, last = int(np.ceil(band[0] * period_s - 1e-9)), int(np.floor(band[1] * period_s + 1e-9))
    first = max(first, 1)
    lines = np.arange(first, last + 1)
    if kind == "all":
        return lines
    lines = lines[lines % 2 == 1]
    if kind == "odd" and detection_fraction > 0 and lines.size >= 4:
        group = max(2, round(1 / detection_fraction))
        # never the first or the last of the band: they bound what the fit may extrapolate
        drop = [
            int(rng.integers(start, min(start + group, lines.size - 1)))
            for start in range(1, lines.size - 1, group)
        ]
        lines = np.delete(lines, drop)
    if lines.size == 0:
        raise InputError(
            f"multisine: no line of a {period_s:g} s period lies in {band[0]:g}…{band[1]:g} Hz; "
            "lengthen the period"
        )
    return lines


def multisine(
    lines: npt.ArrayLike,
    period_samples: int,
    sample_rate: float,
    *,
    rng: np.random.Generator,
    rotations: npt.ArrayLike = (0.0,),
) -> Multisine:
    """Random-phase multisine with amplitudes ∝ f^−½ and a low crest factor.

    The best of ``DRAWS`` random phase sets is improved by clipping in time and keeping the phases in
    frequency (van der Ouderaa's swapping); the objective is the largest peak over all ``rotations``,
    because every one of them is played on some axis in some experiment. Amplitudes are scaled so that
    this peak is 1.
    """
    numbers = np.asarray(lines, dtype=np.int64)
    if numbers.size == 0 or numbers.min() < 1 or 2 * numbers.max() >= period_samples:
        raise InputError(
            f"multisine: lines must lie between 1 and {period_samples // 2 - 1} for "
            f"{period_samples} samples a period"
        )
    turns = np.unique(np.mod(np.asarray(rotations, dtype=float), np.pi))  # half a turn is only a sign
    starts = rng.uniform(0, 2 * np.pi, size=(DRAWS, numbers.size))
    phases, smallest = _low_crest(tuple(numbers.tolist()), tuple(turns.tolist()), starts.tobytes())
    found = Multisine(
        lines=numbers,
        amplitudes=frozen_float(numbers**-0.5 / smallest),
        phases=frozen_float(np.mod(phases, 2 * np.pi)),
        period_samples=period_samples,
        sample_rate=sample_rate,
    )
    # the peak on the samples that are played, not on the coarser grid of the search
    peak = max(float(np.abs(found.period(turn)).max()) for turn in turns)
    return replace(found, amplitudes=frozen_float(found.amplitudes / peak))


@lru_cache(maxsize=64)
def _low_crest(lines: tuple[int, ...], turns: tuple[float, ...], starts: bytes) -> tuple[Float64, float]:
    """Phases (L,) [rad] of the lowest peak that is found from ``starts`` (``DRAWS``, L), and that peak.

    Kept: until a cell moves it is planned half a dozen times, with the same waves at other amplitudes.
    """
    numbers, rotation = np.array(lines), np.array(turns)[:, None]
    # Twice the samples of the highest line resolve the peak of a smooth sum to a few per cent.
    grid = max(256, int(2 ** np.ceil(np.log2(8 * numbers.max()))))

    def peaks(phases: Float64) -> tuple[float, Float64]:
        spectrum = np.zeros((rotation.size, grid // 2 + 1), dtype=complex)
        spectrum[:, numbers] = numbers**-0.5 * np.exp(1j * (phases + rotation)) * (grid / 2)
        waves: Float64 = np.fft.irfft(spectrum, n=grid, axis=1)
        return float(np.abs(waves).max()), waves

    trial = min(np.frombuffer(starts).reshape(DRAWS, -1), key=lambda p: peaks(p)[0])
    phases, smallest = trial, np.inf
    for step in range(ITERATIONS):
        peak, waves = peaks(trial)
        if peak < smallest:
            phases, smallest = trial, peak
        level = peak * (0.8 + 0.15 * step / ITERATIONS)
        clipped = np.fft.rfft(np.clip(waves, -level, level), axis=1)[:, numbers]
        # every rotation votes for the phases it would like, turned back to the common ones
        trial = np.angle(np.sum(clipped * np.exp(-1j * rotation), axis=0))
    return frozen_float(phases), smallest


def orthogonal_rotation(axis: int, experiment: int, count: int) -> float:
    """Phase 2π·i·e/M of axis i in experiment e: the M experiments form a DFT matrix at every line."""
    return 2 * np.pi * ((axis * experiment) % count) / count


def raised_cosine(samples: int) -> Float64:
    """(samples,) ramp from 0 to 1 with zero slope at both ends."""
    ramp: Float64 = 0.5 - 0.5 * np.cos(np.pi * (np.arange(samples) + 0.5) / max(samples, 1))
    return ramp


def apply_ramps(values: Float64, ramp_in: int, ramp_out: int = 0) -> Float64:
    """``values`` (n, …) with a raised-cosine start and end."""
    result = np.array(values, dtype=float)
    tail = (slice(None),) + (None,) * (result.ndim - 1)
    ramp_in, ramp_out = min(ramp_in, len(result)), min(ramp_out, len(result))
    if ramp_in:
        result[:ramp_in] *= raised_cosine(ramp_in)[tail]
    if ramp_out:
        result[-ramp_out:] *= raised_cosine(ramp_out)[::-1][tail]
    return result


CAUGHT = 6.0
"""Radians of its slowest line for which a free mass drifts before a weak hold catches it (an order)."""


def without_drift(period: Float64, sample_rate: float, ramp: int) -> Float64:
    """(n,) a period (n,), begun where a free mass, from rest through a start of ``ramp`` samples,
    is left with the least drift.

    A multisine that begins anywhere leaves it with about the peak velocity of its slowest line, until a weak
    hold has caught it.
    """
    n = period.size
    spectrum = np.fft.rfft(period)
    jw = 2j * np.pi * sample_rate / n * np.arange(spectrum.size)
    integral = np.divide(1.0, jw, out=np.zeros_like(jw), where=jw != 0)
    lost = np.zeros(n)
    lost[:ramp] = (1.0 - raised_cosine(ramp)) / sample_rate
    later = (ramp - np.arange(n)) / sample_rate * lost
    # what a start at each sample lacks of the settled velocity and place, at the ramp's end
    velocity = np.fft.irfft(spectrum * (integral + np.conj(np.fft.rfft(lost))), n)
    place = np.fft.irfft(
        spectrum * (integral**2 + integral * ramp / sample_rate + np.conj(np.fft.rfft(later))), n
    )
    slowest = np.abs(jw[np.flatnonzero(np.abs(spectrum) > 1e-6 * np.abs(spectrum).max())[0]])
    drift = (CAUGHT * velocity) ** 2 + (slowest * place) ** 2
    result: Float64 = np.roll(period, -int(np.argmin(drift)))
    return result


def chirp(band: tuple[float, float], samples: int, sample_rate: float) -> Float64:
    """(samples,) unit linear sweep through ``band`` [Hz], starting as a cosine."""
    t = np.arange(samples) / sample_rate
    duration = samples / sample_rate
    wave: Float64 = np.cos(2 * np.pi * (band[0] * t + 0.5 * (band[1] - band[0]) / duration * t**2))
    return wave


def constant_velocity_path(
    velocity: float, travel: float, sample_rate: float, *, ramp_s: float = 0.2
) -> Float64:
    """(n,) position of a move by ``travel`` and back at ±``velocity``, starting and ending at rest at 0.

    The path is centred: it moves to −travel/2 first, so that the window is used on both sides.
    """
    step = velocity / sample_rate
    ramp = raised_cosine(max(1, round(ramp_s * sample_rate)))
    # a ramp covers half of what the same time at full speed would
    cruise = max(0, round(travel / step - ramp.size))
    out = np.concatenate([ramp, np.ones(cruise), ramp[::-1]])
    out *= travel / out.sum()
    half = out / 2
    path: Float64 = np.cumsum(np.concatenate([-half, out, -out, half]))
    return path


def triangle_path(velocity: float, samples: int, sample_rate: float, travel: float) -> Float64:
    """(samples,) creep at ±``velocity`` between ±``travel``/2, starting at 0."""
    phase = np.arange(samples) * velocity / sample_rate / max(travel, 1e-300)
    wave: Float64 = travel * (0.5 - np.abs(np.mod(phase + 0.5, 2.0) - 1.0))
    return wave


def doublet(samples: int) -> Float64:
    """(4·⌈samples/4⌉,) torque +1, −1, −1, +1: a rigid axis ends at rest where it began.

    The peak displacement of a mass m under amplitude A for T seconds is A·T²/(16·m).
    """
    quarter = max(1, -(-samples // 4))
    wave: Float64 = np.repeat(np.array([1.0, -1.0, -1.0, 1.0]), quarter)
    return wave
