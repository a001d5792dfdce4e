"""Sinusoids that keep their own time: found on the lines between those of a period.

A period's lines hold what repeats; a sinusoid of another frequency f leaks over the lines k of the whole span,
a·e^{jπ(fT − k)}·sinc(fT − k), noise does not. A fan, a pump, another machine, or a loop that hunts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.numerics.arrays import Bool, Complex128, Float64

CHANCE = 1e-3
"""Chance, over all lines, that noise looks like a tone (statistical)."""
MOST_TONES = 3
"""Most tones looked for on one axis of one record."""
SHARE = 0.8
"""Least share of the power between a period's lines, beyond noise, that tones hold (empirical): what changes
with time has much of it on the lines beside those excited."""
NEAR = 12
"""Lines on either side from which a tone is read."""
FINE = 161
"""Frequencies tried between the neighbours of its strongest line."""


@dataclass(frozen=True)
class Tone:
    """A sinusoid's frequency [Hz] and amplitude, in the unit of the lines."""

    hz: float
    amplitude: float


def find_tones(lines: Complex128, noise: Float64, free: Bool, span: float) -> list[Tone]:
    """Tones in amplitudes (A,) on the lines k/T of a span T, the strongest first; none where they are not
    most of what stands above ``noise`` (A,) on the ``free`` (A,) lines."""
    number = np.flatnonzero(free)
    if number.size < 2 * NEAR:
        return []
    rest, power = lines[number].copy(), noise[number]
    level = max(float(np.median(np.abs(rest) ** 2 / power)) / np.log(2.0), 1.0)
    power = power * level
    excess = float((np.abs(rest) ** 2 / power).sum()) - number.size
    limit = float(np.log(4.0 * number.size / CHANCE))
    found: list[Tone] = []
    taken = 0.0
    for _ in range(MOST_TONES):
        at, size, gain = _strongest(rest, power, number)
        if gain < limit:
            break
        rest = rest - size * _leakage(at - number)
        found.append(Tone(at / span, abs(size)))
        taken += gain
    return sorted(found, key=lambda t: -t.amplitude) if found and taken > SHARE * excess else []


def _strongest(rest: Complex128, power: Float64, number: np.ndarray) -> tuple[float, complex, float]:
    """Cycles in the span, complex amplitude and gain of the tone that explains most around the largest line."""
    peak = int(np.argmax(np.abs(rest) ** 2 / power))
    near = np.abs(number - number[peak]) <= NEAR
    weight, seen = 1.0 / power[near], rest[near]
    cycles = number[peak] + np.linspace(-1.0, 1.0, FINE)
    shape = _leakage(cycles[:, None] - number[near])
    told = (shape.conj() * weight * seen).sum(axis=1)
    known = (np.abs(shape) ** 2 * weight).sum(axis=1)
    gain = np.abs(told) ** 2 / np.maximum(known, 1e-300)
    best = int(np.argmax(gain))
    return float(cycles[best]), complex(told[best] / known[best]), float(gain[best])


def _leakage(cycles: np.ndarray) -> Complex128:
    """Amplitude on a line that is ``cycles`` of the span away from a tone of amplitude one."""
    out: Complex128 = np.exp(1j * np.pi * cycles) * np.sinc(cycles)
    return out
