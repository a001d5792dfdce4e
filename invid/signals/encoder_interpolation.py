"""Interpolation error of encoders: what they err by within each period of their scale, found and taken out.

The sine and cosine tracks of an encoder have offsets, unequal sizes and harmonics; the position interpolated
from them errs by one or two cycles in each period of the scale, always alike at the same position. It repeats
with the motion, so means over periods keep it, and where a motor turns round slowly it moves the reversal.
Where the motor is fast it stands alone, at frequencies that no torque moves an inertia at, and is read there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from invid.numerics.arrays import Float64
from invid.recording.model import Recording
from invid.wording.sentence import sentence

LEAST_SHARE, LEAST_OVER_BAND = 0.125, 3.0
"""Lowest frequency that counts as fast, over the sample rate and over the highest excited one (empirical:
whole cells; there a motor's own motion is below the encoder's counts)."""
MOST_CYCLES = 16384.0
"""Most waves of an error in a turn (or in 2π m): one in each of 16384 lines, the finest common scale."""
LEAST_WAVES = 8.0
"""Fewest waves within the way: the motion itself is a wave over about one."""
MOST_WAVES = 6
"""Most waves of one encoder: with their harmonics two or three are usual."""
CHANCE = 1e-6
"""Chance that noise passes for a wave, over all cycles tried (statistical)."""
SPEED_CHANGE = 0.3
"""Share by which a wave may differ between faster and slower motion. Physical: an encoder's error does not
depend on speed; motion that a torque ripple makes falls off with its square."""
FEWEST = 500
"""Fewest samples of an axis from which an error is sought."""


@dataclass(frozen=True, eq=False)
class _Readings:
    """Positions of one axis in all experiments, and what of them is fast."""

    position: tuple[Float64, ...]
    fast: Float64
    share: float
    """Lowest frequency that counts as fast, over the sample rate."""

    def filtered(self, waves: Sequence[Float64]) -> Float64:
        """(n,) the fast part of waves of all experiments, one after the other."""
        return _fast_part(waves, self.share)

    def columns(self, cycles: Sequence[float]) -> Float64:
        """(n, 2k) fast parts of sine and cosine of each number of ``cycles``."""
        turns = [(np.sin, n) for n in cycles] + [(np.cos, n) for n in cycles]
        return np.stack([self.filtered([f(n * x) for x in self.position]) for f, n in turns], axis=1)


def remove_interpolation_error(recording: Recording) -> tuple[Recording, list[str]]:
    """The recording without its encoders' interpolation errors, and a note for each axis that has one."""
    notes, unit = list[str](), "m" if recording.linear else "rad"
    positions = [e.position.copy() for e in recording.experiments]
    for i, axis in enumerate(recording.axes):
        readings = _readings(recording, i)
        waves = [] if readings is None else _find_waves(readings)
        if not waves:
            continue
        for position in positions:
            own = position[:, i].copy()
            position[:, i] -= sum(a * np.sin(n * own) + b * np.cos(n * own) for n, a, b in waves)
        said = ", ".join(
            f"{np.hypot(a, b):.2g} {unit} in each {2e6 * np.pi / n:.4g} µm"
            if recording.linear
            else f"{np.hypot(a, b):.2g} {unit}, {n:.5g} times a turn"
            for n, a, b in waves
        )
        notes.append(
            sentence(
                "the encoder of axis {axis} errs within the periods of its scale ({said}); taken "
                "out of its positions",
                axis=axis,
                said=said,
            )
        )
    if not notes:
        return recording, []
    experiments = [
        replace(e, position=position) for e, position in zip(recording.experiments, positions, strict=True)
    ]
    return replace(recording, experiments=tuple(experiments)), notes


def _readings(recording: Recording, axis: int) -> _Readings | None:
    """The readings of an axis; ``None`` where they are too few, unevenly sampled, or too slowly sampled."""
    rates = {float(e.sample_rate_hz) for e in recording.experiments}
    tops = [float(e.frequencies_hz[-1]) for e in recording.experiments if e.frequencies_hz.size]
    position = tuple(e.position[:, axis] for e in recording.experiments)
    if len(rates) != 1 or sum(x.size for x in position) < FEWEST or min(x.size for x in position) < 64:
        return None
    share = max(LEAST_SHARE, LEAST_OVER_BAND * max(tops, default=0.0) / rates.pop())
    if share > 0.4 or not all(np.isfinite(x).all() for x in position):
        return None
    return _Readings(position, _fast_part(position, share), share)


def _fast_part(waves: Sequence[Float64], share: float) -> Float64:
    """A Butterworth filter of order 4 there and back; ``scipy.signal`` takes half a second to load."""
    out = []
    for x in waves:
        pad = min(256, x.size - 1)
        long = np.concatenate((2 * x[0] - x[pad:0:-1], x, 2 * x[-1] - x[-2 : -pad - 2 : -1]))
        size = scipy.fft.next_fast_len(long.size, real=True)
        angle = np.tan(np.pi * np.fft.rfftfreq(size)[1:])
        gain = np.concatenate(([0.0], 1.0 / (1.0 + (np.tan(np.pi * share) / angle) ** 8)))
        out.append(np.fft.irfft(gain * np.fft.rfft(long, size), size)[pad : pad + x.size])
    return np.concatenate(out)


def _find_waves(readings: _Readings) -> list[tuple[float, float, float]]:
    """Wavenumber [rad/rad, rad/m], sine and cosine of each wave of the error, the strongest first."""
    cycles, left = list[float](), readings.fast
    sizes: Float64 = np.zeros(0)
    while len(cycles) < MOST_WAVES:
        found = _strongest(readings, left)
        if found is None:
            break
        tried = [*cycles, found]
        columns = readings.columns(tried)
        trial = np.asarray(np.linalg.lstsq(columns, readings.fast, rcond=None)[0], dtype=np.float64)
        if not _is_of_encoder(readings, columns, trial):
            break
        cycles, sizes, left = tried, trial, readings.fast - columns @ trial
    count = len(cycles)
    return [(n, float(sizes[k]), float(sizes[count + k])) for k, n in enumerate(cycles)]


def _strongest(readings: _Readings, left: Float64) -> float | None:
    """Cycles of the strongest wave in what is ``left`` (n,); ``None`` where noise may be as strong."""
    x = np.concatenate(readings.position)
    width = 2 * np.pi / (4.0 * MOST_CYCLES)
    bins = ((x - x.min()) / width).astype(int)
    size = scipy.fft.next_fast_len(2 * (int(bins.max()) + 1), real=True)
    if size > 1 << 24:
        return None  # a drive of hundreds of turns
    power = np.abs(np.fft.rfft(np.bincount(bins, weights=left), size)) ** 2
    spacing = 2 * np.pi / (size * width)
    last = int(MOST_CYCLES / spacing)
    first = int(np.ceil(2 * np.pi * LEAST_WAVES / spacing / max(float(np.ptp(x)), 1e-300)))
    if first >= last:
        return None
    noise = float(np.median(power[first:last])) / np.log(2.0)
    at = first + int(np.argmax(power[first:last]))
    if not power[at] > noise * np.log((last - first) / CHANCE):
        return None

    def missed(n: float) -> float:
        columns = readings.columns([n])
        own, *_ = np.linalg.lstsq(columns, left, rcond=None)
        rest = left - columns @ own
        return float(rest @ rest)

    around = (max(at - 2, first) * spacing, (at + 2) * spacing)
    found = scipy.optimize.minimize_scalar(
        missed, bounds=around, method="bounded", options={"xatol": 1e-3 * spacing}
    )
    return float(found.x)


def _is_of_encoder(readings: _Readings, columns: Float64, sizes: Float64) -> bool:
    """Whether the last wave is as strong in slower as in faster motion."""
    count = sizes.size // 2
    speed = np.concatenate([np.abs(np.gradient(x)) for x in readings.position])
    own = columns[:, [count - 1, 2 * count - 1]]
    left = readings.fast - columns @ sizes + own @ sizes[[count - 1, 2 * count - 1]]
    weight = np.hypot(own[:, 0], own[:, 1])
    shown = weight > 0.5  # fast enough to pass the filter
    if shown.sum() < FEWEST // 4:
        return False
    middle = np.median(speed[shown])
    sides = [shown & (speed <= middle), shown & (speed > middle)]
    slow, fast = (np.linalg.lstsq(own[s], left[s], rcond=None)[0] for s in sides)
    return bool(np.hypot(*(slow - fast)) < SPEED_CHANGE * max(np.hypot(*slow), np.hypot(*fast)))
