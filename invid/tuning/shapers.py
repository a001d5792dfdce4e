"""Input shapers for the lowest mode of a load: impulses that a command is convolved with.

ZV and ZVD: Singer and Seering, J. Dyn. Syst. Meas. Control 112 (1990). EI, which leaves ``TOLERANCE`` at the
mode and no more around it: Singhose, Seering and Singer, J. Mech. Des. 116 (1994), with the impulses damped
as those of ZVD.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from invid.numerics.arrays import Float64

TOLERANCE = 0.05
"""Vibration that may stay, as a share of that without a shaper."""
DAMPED = 3.0 / (2.0 * np.pi)
"""Damping ratio from which a vibration falls to a twentieth in less than a period, the length of ZVD and EI:
no shaper is faster than that."""


@dataclass(frozen=True)
class Shaper:
    """``kind`` "zv", "zvd" or "ei" for a mode of ``frequency`` [Hz] and ``damping``; ``times`` [s] and
    ``amplitudes`` (sum 1) of its impulses; ``residual`` vibration in the worst draw, as a share of none."""

    kind: str
    frequency: float
    damping: float
    times: tuple[float, ...]
    amplitudes: tuple[float, ...]
    residual: float = 0.0

    def shape(self, command: Float64, cycle: float) -> Float64:
        """(n,) a command shaped, linear between its samples; before its start it stood still."""
        time = np.arange(command.size) * cycle
        parts = [
            a * np.interp(time - t, time, command) for t, a in zip(self.times, self.amplitudes, strict=True)
        ]
        result: Float64 = np.sum(parts, axis=0)
        return result


def _zv(k: float) -> tuple[Float64, Float64]:
    return np.array([0.0, 0.5]), np.array([1.0, k])


def _zvd(k: float) -> tuple[Float64, Float64]:
    return np.array([0.0, 0.5, 1.0]), np.array([1.0, 2.0 * k, k * k])


def _ei(k: float) -> tuple[Float64, Float64]:
    outer = (1.0 + TOLERANCE) / 4.0
    return np.array([0.0, 0.5, 1.0]), np.array([outer, (1.0 - TOLERANCE) / 2.0 * k, outer * k * k])


KINDS: dict[str, Callable[[float], tuple[Float64, Float64]]] = {"zv": _zv, "zvd": _zvd, "ei": _ei}
"""The shortest first; times in damped periods."""


def residual_vibration(shaper: Shaper, frequency: float, damping: float) -> float:
    """Vibration that is left of a mode [Hz], as a share of that after the command unshaped."""
    w = 2 * np.pi * frequency
    times, sizes = np.array(shaper.times), np.array(shaper.amplitudes)
    turn = np.exp((damping * w + 1j * w * np.sqrt(1.0 - damping**2)) * (times - times[-1]))
    return float(np.abs(np.sum(sizes * turn)))


def choose_shaper(nominal: tuple[float, float], draws: Sequence[tuple[float, float]]) -> Shaper | None:
    """The shortest shaper that leaves at most ``TOLERANCE`` in every draw, else the one that leaves least;
    ``None`` where the loop damps the mode by itself."""
    frequency, damping = nominal
    if damping >= DAMPED:
        return None
    tried = []
    for kind, made in KINDS.items():
        root = np.sqrt(1.0 - damping**2)
        times, sizes = made(float(np.exp(-damping * np.pi / root)))
        at = times / (frequency * root)
        bare = Shaper(kind, frequency, damping, tuple(at), tuple(sizes / sizes.sum()), 0.0)
        worst = max(residual_vibration(bare, f, d) for f, d in (nominal, *draws))
        tried.append(Shaper(kind, frequency, damping, bare.times, bare.amplitudes, worst))
        if worst <= TOLERANCE:
            return tried[-1]
    return min(tried, key=lambda s: s.residual)
