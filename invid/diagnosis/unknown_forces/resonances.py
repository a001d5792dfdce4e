"""Where a resonance that is not modelled may be: first-order falls of −2 ln L over its frequency.

A mass m on a spring resists at its host with m·f(ω), f = −ω²s/(s − ω²) and s = ω₀² + 2jζω₀ω; a base on which
the loads stand with c cᵀ·f/M, but for an inertia of the loads that is free anyway. To first order both are a
symmetric matrix times f: one term of its diagonal, or rank one over the loads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from invid.likelihood.unknown_forces.background import Background
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.slope import inner_motion, solve_scaled, whitened_rows
from invid.numerics.arrays import Complex128, Float64

BAND, SPACING, DAMPING = (0.04, 1.6), 1.06, 0.03
"""Frequencies that are scanned over the highest excited one, the ratio of neighbours, and the damping ratio:
a resonance is as wide as its neighbours are apart."""
FINE, DAMPINGS = 1.01 ** np.arange(-5, 6), (0.003, 0.01, 0.03, 0.1)
"""Frequencies over a peak's, and damping ratios, among which it is looked at more closely."""
PEAKS = 3
"""Peaks that are looked at."""

Place = tuple[int, int]
"""Two coordinates, or twice the same, between which something resists."""


@dataclass(frozen=True, eq=False)
class Resonance:
    """Frequency [rad/s], damping ratio, first-order fall of −2 ln L, and (k,) size at each of its places."""

    frequency: float
    damping: float
    fall: float
    sizes: Float64


class Scan:
    """Everything else of a fit projected out, strengths as they are."""

    def __init__(self, now: FittedHypothesis) -> None:
        structure = now.hypothesis.structure
        self.work = now.fit.value.work
        self.loads: list[Place] = [*combinations_with_replacement(structure.load, 2)]
        hosts = [a for a in range(sum(structure.sizes)) if a not in structure.load]
        self.places = [*self.loads, *((a, a) for a in hosts)]
        self.background = Background.of(now)
        self.seen = [_seen(now, k, self.places) for k in range(len(self.work))]
        count = int(np.log(BAND[1] / BAND[0]) / np.log(SPACING)) + 1
        self.frequencies = top(now) * BAND[0] * SPACING ** np.arange(count)
        self.normals = [self._normal(f, DAMPING, range(len(self.places))) for f in self.frequencies]

    def fall(self, places: Sequence[Place]) -> float:
        """The highest fall at places."""
        return float(self._falls(places).max())

    def peaks(self, places: Sequence[Place], least: float) -> list[Resonance]:
        """The highest resonances at places whose fall is beyond ``least``, the highest first."""
        falls, at = self._falls(places), self._numbers(places)
        padded = np.concatenate(([0.0], falls, [0.0]))
        tops = np.flatnonzero((falls >= padded[:-2]) & (falls >= padded[2:]) & (falls > least))
        out = []
        for k in tops[np.argsort(-falls[tops])][:PEAKS]:
            close = [
                _resonance(self._normal(own, damping, at), own, damping)
                for own in self.frequencies[k] * FINE
                for damping in DAMPINGS
            ]
            out.append(max(close, key=lambda r: r.fall))
        return out

    def _numbers(self, places: Sequence[Place]) -> list[int]:
        return [self.places.index(p) for p in places]

    def _falls(self, places: Sequence[Place]) -> Float64:
        at = self._numbers(places)
        parts = [(normal[np.ix_(at, at)], pull[at]) for normal, pull in self.normals]
        return np.array([_resonance(part, 0.0, 0.0).fall for part in parts])

    def _normal(self, own: float, damping: float, at: Sequence[int]) -> tuple[Float64, Float64]:
        columns = []
        for work, seen in zip(self.work, self.seen, strict=True):
            answer = mode_answer(work.stack.omega, own, damping)
            rows = whitened_rows(work, seen[..., at] * answer[:, None, None])
            columns.append(rows.reshape(-1, len(at)))
        return self.background.beside(columns)


def _resonance(normal: tuple[Float64, Float64], own: float, damping: float) -> Resonance:
    sizes = solve_scaled(normal[0], -normal[1])
    fall = -float(normal[1] @ sizes)
    return Resonance(own, damping, fall if sizes.size > 1 or sizes[0] > 0.0 else 0.0, sizes)


def mode_answer(omega: Float64, own: float, damping: float) -> Complex128:
    """(F,) resistance of a unit mass on a spring of frequency ``own``."""
    spring = own**2 + 2j * damping * own * omega
    out: Complex128 = -(omega**2) * spring / (spring - omega**2)
    return out


def top(now: FittedHypothesis) -> float:
    """Highest excited frequency [rad/s]."""
    return 2 * np.pi * max(r.top_hz for s in now.bench.stacks for r in s.records)


def _seen(now: FittedHypothesis, number: int, places: Sequence[Place]) -> Complex128:
    """(R, F, M, P) change of the missing torque by a unit resistance at each place, of one stack."""
    motion = now.fit.value.work[number].condensed.motion
    moved = inner_motion(now.fit.problem, now.fit.value, number)
    columns = [
        motion[..., a] * moved[..., b, None] + (motion[..., b] * moved[..., a, None] if a != b else 0.0)
        for a, b in places
    ]
    return np.stack(columns, axis=-1)
