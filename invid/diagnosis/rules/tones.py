"""Rule: torque at one frequency that repeats with none of the periods: a fan, a pump, a hunting loop.

Averaged over periods it looks like noise, and the scatter between them counts it as such. From period to
period it turns by 2πfT, which noise does not, and within a period it leaks over the lines as one sinusoid
does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.diagnosis.tone import Tone
from invid.effects.motion import View
from invid.likelihood.evaluation import Evaluation
from invid.likelihood.hypothesis import Layout
from invid.likelihood.nuisance.transients import project_out_ends
from invid.likelihood.null_test import period_deviations
from invid.likelihood.residual import condense_dense
from invid.numerics.arrays import Complex128, Float64
from invid.signals.spectra import LineSpectra

CHANCE = 1e-3
"""Chance, over all frequencies, axes and records together, that noise looks like a tone (statistical)."""
MOST_TONES = 3
"""Most tones searched for in one record."""
SHARE = 0.8
"""Least share of all non-repeating torque beyond noise that tones must hold. Empirical: a load or a spring
that changes has much of it on the lines beside those excited, and those at a resonance stand out too."""


def find_common_tones(
    evaluations: Sequence[Evaluation], layout: Layout, p: Float64, spectra: Sequence[LineSpectra]
) -> list[Tone]:
    """Tones that are in all periodic records of the evaluations."""
    known = {s.key: s for s in spectra}
    # Periods of one experiment may train and others be held out: its tones are those of all of them, once.
    views = list({v.record.key: v for e in evaluations for v in e.views}.values())
    axes = sum(v.record.torque.shape[1] for v in views)
    found: list[list[Tone]] = []
    width = 0.0
    for view in views:
        record, s = view.record, known[view.record.key]
        periods = s.deviations.shape[0]
        if periods >= 2 and not record.alone and not record.weight.size:
            width = max(width, 1.0 / (periods * record.period_time))
            found.append(_tones_of_record(view, s, layout, p, axes))
            if not found[-1]:
                return []

    def is_everywhere(tone: Tone) -> bool:
        return all(
            any(t.axis == tone.axis and abs(t.frequency_hz - tone.frequency_hz) < width for t in tones)
            for tones in found
        )

    return [tone for tones in found for tone in tones if is_everywhere(tone)]


def _tones_of_record(view: View, s: LineSpectra, layout: Layout, p: Float64, axes: int) -> list[Tone]:
    """Tones of one record, the largest first; none where they are less than ``SHARE`` of what does not
    repeat."""
    record, structure = view.record, layout.structure
    periods, lines = s.deviations.shape[0], record.omega.size - 1
    samples = round(record.period_time / record.step)
    start = record.end_time - periods * record.period_time + record.step
    limit = np.log(4.0 * periods * lines * axes / CHANCE)

    def whiten(of: LineSpectra) -> Complex128:
        e, covariance, used = period_deviations(view, of)
        # Motion that does not repeat does not close over a period either.
        e, _ = project_out_ends(view, layout, p, e, covariance)
        single = np.einsum("fii->fi", covariance).real - record.scatter[1:]
        out: Complex128 = e / np.sqrt(single * used)
        return out

    left, found = whiten(s), []
    # Noise keeps (P − 1)/P of its power beside the mean; the median does not react to tones.
    level = np.median(np.abs(left) ** 2, axis=(0, 1)) / np.log(2.0) * periods / (periods - 1)
    level = np.sqrt(np.maximum(level, 1.0))
    left = left / level
    excess = (np.abs(left) ** 2).sum(axis=(0, 1)) - (periods - 1) * lines
    total_gain = np.zeros(excess.size)
    for _ in range(MOST_TONES):
        peaks = [_strongest_line(left[..., i], record.period_time) for i in range(excess.size)]
        axis = int(np.argmax([power for _, power in peaks]))
        hz, channels = _refine_tone(s, peaks[axis][0], record.period_time, samples)
        columns = _deviation_columns(periods, s.deviations.shape[1], hz, record.period_time, samples)
        deviations = s.deviations - columns[0][..., None] * channels - columns[1][..., None] * channels.conj()
        cleaner = replace(s, deviations=deviations)
        whitened_rest = whiten(cleaner) / level
        gain = (np.abs(left) ** 2).sum(axis=(0, 1)) - (np.abs(whitened_rest) ** 2).sum(axis=(0, 1))
        if gain[axis] < limit:
            break
        s, left, total_gain = cleaner, whitened_rest, total_gain + gain
        at = np.array([2 * np.pi * hz])
        stiffness = condense_dense(structure, p[: structure.count], at)[1][0]
        k = int(np.clip(round(hz * record.period_time), 1, lines))
        acting = channels[structure.motors :] * (view.acting[k] / record.torque[k])
        force = stiffness @ channels[: structure.motors] - acting
        found.append(Tone(axis, hz, float(np.abs(force[axis])), channels, start, record.key))
    return [t for t in found if total_gain[t.axis] > SHARE * excess[t.axis]]


def _strongest_line(white: Complex128, period: float) -> tuple[float, float]:
    """Frequency [Hz] and power of the largest line of the whole record, the deviations of its periods in a
    row."""
    periods, lines = white.shape
    half = np.zeros((periods, lines + 2), dtype=complex)
    half[:, 1:-1] = white
    wave = np.fft.irfft(half, axis=1).ravel()
    power = np.abs(np.fft.rfft(wave)[: periods * (lines + 1)]) ** 2
    return float(np.argmax(power)) / (periods * period), float(power.max())


def _refine_tone(s: LineSpectra, hz: float, period: float, samples: int) -> tuple[float, Complex128]:
    """The frequency near ``hz`` that explains most of the channels' deviations, and their (2M,) phasors."""
    periods, lines, channels = s.deviations.shape
    scale = np.sqrt(np.maximum(s.floor, 1e-300))
    white = s.deviations / scale
    goal = np.concatenate((white.real, white.imag)).reshape(-1, channels)

    def fit_tone(f: float) -> tuple[float, Complex128]:
        up, down = _deviation_columns(periods, lines, f, period, samples)
        both = np.stack((up + down, 1j * (up - down)), axis=-1)
        rows = np.concatenate((both.real, both.imag)).reshape(-1, 2)
        size, *_ = np.linalg.lstsq(rows, goal, rcond=None)
        return float(((rows @ size) ** 2).sum()), (size[0] + 1j * size[1]) * scale

    # To the next line and beyond: multiples of 1/T, where the mean of the periods takes all, show nothing.
    step = 1.0 / (periods * period)
    for _ in range(5):  # an eighth of the step each time: to a ten-thousandth of a line
        grid = [f for f in hz + step * np.linspace(-1.0, 1.0, 17) if f > 0]
        hz = float(max(grid, key=lambda f: fit_tone(f)[0]))
        step /= 8.0
    return hz, fit_tone(hz)[1]


def _deviation_columns(
    periods: int, lines: int, hz: float, period: float, samples: int
) -> tuple[Complex128, Complex128]:
    """(P, F) deviations that a phasor of one makes, and those that its conjugate makes."""
    rotation = np.exp(2j * np.pi * hz * period * np.arange(periods))
    rotation = rotation - rotation.mean()
    index = np.arange(1, lines + 1)
    near, far = (
        _leakage(np.asarray(sign * hz * period - index, dtype=np.float64), samples) for sign in (1, -1)
    )
    return rotation[:, None] * near, rotation.conj()[:, None] * far


def _leakage(cycles: Float64, samples: int) -> Complex128:
    """Amplitude on a line that is ``cycles`` of its period away from a tone of amplitude one."""
    rotation = np.exp(1j * np.pi * cycles * (1.0 - 1.0 / samples))
    out: Complex128 = rotation * np.sinc(cycles) / np.sinc(cycles / samples)
    return out
