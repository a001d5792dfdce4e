"""Laws that jump with the sign of the velocity, or bend within a sample, averaged over their samples so that
neither aliases.

With the velocity linear between samples, the mean of a law over an interval is ΔΦ/Δv, Φ the law's
antiderivative (antiderivative antialiasing); a sample gets the mean of the intervals around it. Friction that
turns its motor round bends that line at zero, where it changes its sign: the interval then has two of them.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import partial
from math import erf, exp, log1p, pi, sqrt, tanh
from typing import Self

import numpy as np

from invid.effects.effect import ForceEffect
from invid.effects.motion import View
from invid.model.document import EffectTerm
from invid.model.place import Place
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.compiled import compiled
from invid.signals.standstill import Standstill, sign_threshold

ROUNDING = "rounding"
"""Name of the further parameter that friction has in a model where its sign changes over gradually."""
FAR = 15.0
"""Velocity over the softness from which a sign is one: exp(−30) is beyond the digits of a float."""

TURNS = 0.1
"""Change of velocity over an interval that friction takes off when it turns round, over the velocity's
softness, above which the corner is looked at: below, noise hides when it was by more."""
PASSES = 2
"""Half steps towards the velocity beyond the band and the friction that go with each other. A whole one goes
too far where friction takes more than half of a motor's change of pace."""


class DryLaw(ForceEffect):
    """A friction law that changes over with the sign of the velocity, at once or over a range of it."""

    answered = True
    rounding: float = 0.0
    """Velocity over which the sign changes over, tanh(v/rounding) [rad/s or m/s]; 0: at once. No contact
    reverses at once: creep, lubricant and the simulation of others round the corner."""

    def rounded(self, velocity: float) -> Self:
        """The same law with another rounding."""
        other = copy.copy(self)
        other.rounding = velocity
        return other

    def known(self, term: EffectTerm) -> Self:
        return self.rounded(term.value(ROUNDING)) if ROUNDING in term.parameters else self

    def __eq__(self, other: object) -> bool:
        """A law has no state but its rounding: two that round alike are one, wherever they were made."""
        return isinstance(other, DryLaw) and (type(self), self.rounding) == (type(other), other.rounding)

    def __hash__(self) -> int:
        return hash((type(self), self.rounding))

    def softness(self, view: View, place: Place) -> float:
        """Velocity over which the sign changes over: the rounding, or the velocity's noise if larger."""
        v = view.velocity(place.pattern(view.structure))
        return max(sign_threshold(v, float(view.record.velocity_noise[place.axis])), self.rounding)

    def stands(self, view: View, place: Place) -> bool:
        return self._standing(view, place) is not None

    def held(self, x: Sequence[float]) -> tuple[float, float]:
        """Least and largest resistance of what does not move."""
        raise NotImplementedError

    def of(self, v: Float64, soft: float, shape: Sequence[float], turn: float) -> Float64:
        """(n, L) resistance at velocities ``v`` (n,) for each coefficient at one; see ``sign_law``."""
        raise NotImplementedError

    def law(self, view: View, place: Place, shape: Sequence[float]) -> Float64:
        v = view.velocity(place.pattern(view.structure))
        return self.of(v, self.softness(view, place), shape, 0.0)

    def contribution(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[Complex128, Complex128 | None]:
        if place.number != 1 or self.rounding > 0.0:
            return super().contribution(view, place, x)
        pattern = place.pattern(view.structure)
        still = self._standing(view, place)
        # What acts while it stands changes with inner motion; what resists while it moves hardly does.
        moving = view.measured((self, place, tuple(x)), lambda: self._moving(view, place, x))
        wave = moving if still is None else still.held(moving, _acting(view, place), *self.held(x))
        total = view.to_lines(wave[:, None], smeared=self.smeared)
        return view.push(pattern) * total, -view.yields(pattern) * total

    def _moving(self, view: View, place: Place, x: Sequence[float]) -> Float64:
        """(n,) resistance of a motor while it moves, with the corners that friction makes at reversals."""
        count, record = len(self.coefficients), view.record
        still, soft = self._standing(view, place), self.softness(view, place)
        low, high = self.held(x)
        lightness = float(view.inertance[place.axis, place.axis])
        turn = (high - low) * lightness * record.wave_step
        turn = turn if turn > TURNS * soft else 0.0
        held = None if still is None else partial(still.held, acting=_acting(view, place), low=low, high=high)
        v = view.velocity(place.pattern(view.structure))

        def resisting(hidden: Float64 | float) -> Float64:
            out: Float64 = self.of(v - hidden, soft, x[count:], turn) @ np.asarray(x[:count])
            return out

        moving = resisting(0.0)
        for _ in range(PASSES if turn and not record.transient else 0):
            wave = moving if held is None else held(moving)
            moving = 0.5 * (moving + resisting(lightness * record.unseen_speed(wave, place.axis)))
        return moving

    def holding(self, view: View, place: Place, x: Sequence[float]) -> Float64 | None:
        """(n,) share of each sample in which whatever acts on a motor that stands holds it; ``None`` where it
        never stands."""
        still = self._standing(view, place)
        if still is None:
            return None
        low, high = self.held(x)
        acting = _acting(view, place)
        out: Float64 = still.share * ((acting > low) & (acting < high))
        return out

    def _standing(self, view: View, place: Place) -> Standstill | None:
        """When the motor stands; none for inner masses, for contacts that creep, and for a motor that is a
        load as well, which feels the other loads."""
        sizes = view.structure.sizes
        told = place.kind == "mass" and place.number == 1 and (sizes[place.axis] > 1 or len(sizes) == 1)
        return view.record.standing[place.axis] if told and self.rounding == 0.0 else None


def _acting(view: View, place: Place) -> Float64:
    """(n,) torque on a motor by its drive and its spring."""
    at = view.structure.motor_dofs[place.axis]
    axis = place.axis
    torque = view.measured(("torque", axis), lambda: view.record.to_wave(view.acting[:, axis]))
    if view.structure.sizes[axis] == 1:
        return torque
    spring, pattern = view.structure.spring_pairs.index((at, at + 1)), ((at + 1, 1.0), (at, -1.0))
    k, d = float(view.springs[spring]), float(view.dampers[spring])
    out: Float64 = torque + k * view.wave(pattern) + d * view.velocity(pattern)
    return out


@compiled
def mean_between(v: np.ndarray, phi: np.ndarray, plain: np.ndarray, turn: float, rest: float) -> np.ndarray:
    """(n,) mean over the intervals around each sample of a wave that closes; ``turn`` see ``sign_law``,
    ``rest`` is the antiderivative at zero."""
    count = v.size
    small = 1e-9 * np.abs(v).max()
    out = np.empty(count)
    before = 0.0
    for k in range(-1, count):
        a = k if k >= 0 else count - 1
        b = k + 1 if k + 1 < count else 0
        dv = v[b] - v[a]
        if turn > 0.0 and v[a] * v[b] < 0.0:
            # Zero is not where the straight line has it: turn·s² − (|v_a| + |v_b| + turn)·s + |v_a| = 0.
            slow, fast = abs(v[a]), abs(v[b])
            both = slow + fast + turn
            share = 2.0 * slow / (both + sqrt(both * both - 4.0 * slow * turn))
            # Before and after it a straight line each, from and to zero.
            bent = (1.0 - share) * (phi[b] - rest) / fast - share * (phi[a] - rest) / slow
            now = bent if v[b] > 0.0 else -bent
        elif abs(dv) <= small:
            now = 0.5 * (plain[a] + plain[b])
        else:
            now = (phi[b] - phi[a]) / dv
        if k >= 0:
            out[k] = 0.5 * (before + now)
        before = now
    return out


@compiled
def _sign(v: np.ndarray, soft: float, turn: float) -> np.ndarray:
    phi, plain = np.empty(v.size), np.empty(v.size)
    for k in range(v.size):
        u = abs(v[k]) / soft
        near = u < FAR
        phi[k] = soft * (u + (log1p(exp(-2.0 * u)) if near else 0.0))
        size = tanh(u) if near else 1.0
        plain[k] = size if v[k] > 0 else -size
    return mean_between(v, phi, plain, turn, soft * log1p(1.0))


@compiled
def _excess(v: np.ndarray, soft: float, width: float, turn: float) -> np.ndarray:
    phi, plain = np.empty(v.size), np.empty(v.size)
    for k in range(v.size):
        u, w = abs(v[k]) / soft, abs(v[k]) / width
        # What the sign has not reached yet where it changes over, as if the bend were one there.
        late = soft * (log1p(exp(-2.0 * u)) if u < FAR else 0.0)
        phi[k] = width * sqrt(pi) / 2 * erf(w) + late
        size = (tanh(u) if u < FAR else 1.0) * exp(-w * w)
        plain[k] = size if v[k] > 0 else -size
    return mean_between(v, phi, plain, turn, soft * log1p(1.0))


@compiled
def _clipped(d: np.ndarray, half: float) -> np.ndarray:
    phi, plain = np.empty(d.size), np.empty(d.size)
    for k in range(d.size):
        u = abs(d[k])
        phi[k] = 0.5 * u * u if u < half else half * (u - 0.5 * half)
        plain[k] = min(max(d[k], -half), half)
    return mean_between(d, phi, plain, 0.0, 0.0)


def clip_law(d: Float64, half: float) -> Float64:
    """(n,) the deflection, within ±half."""
    out: Float64 = _clipped(np.ascontiguousarray(d), half)
    return out


def sign_law(v: Float64, soft: float, turn: float = 0.0) -> Float64:
    """(n,) the sign of the velocity.

    ``turn``: what the friction itself takes off the change of velocity over an interval once it has turned
    round: its jump over the mass, times the interval. The velocity is no straight line there, and zero comes
    earlier: at 34 dB over the noise that was four times the noise.
    """
    out: Float64 = _sign(np.ascontiguousarray(v), soft, turn)
    return out


def excess_law(v: Float64, soft: float, width: float, turn: float = 0.0) -> Float64:
    """(n,) sign(v)·exp(−(v/width)²); ``turn`` see ``sign_law``."""
    out: Float64 = _excess(np.ascontiguousarray(v), soft, width, turn)
    return out


@compiled
def _even(v: np.ndarray, soft: float) -> np.ndarray:
    phi, plain = np.empty(v.size), np.empty(v.size)
    for k in range(v.size):
        u = v[k] / soft
        size = tanh(u) if abs(u) < FAR else (1.0 if u > 0 else -1.0)
        phi[k], plain[k] = v[k] - soft * size, size * size
    return mean_between(v, phi, plain, 0.0, 0.0)


def even_law(v: Float64, soft: float) -> Float64:
    """(n,) the square of the sign: one, but where it changes over."""
    out: Float64 = _even(np.ascontiguousarray(v), soft)
    return out


def stribeck_decay(velocity: Float64, shape: Sequence[float]) -> Float64:
    """(n,) exp(−(|v|/v₀)^exponent), ``shape`` (v₀, exponent): the part of friction at low speed alone."""
    out: Float64 = np.exp(-((np.abs(velocity) / (shape[0] or 1.0)) ** max(int(shape[1]), 1)))
    return out
