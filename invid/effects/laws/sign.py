"""Laws that jump with the sign of the velocity, averaged over their samples so that they do not alias.

With the velocity linear between samples, the mean of a law over an interval is ΔΦ/Δv, Φ the law's
antiderivative (antiderivative antialiasing); a sample gets the mean of the intervals around it. At a motor
whose drive's torque is recorded, the motor's own equation says more (``motor_balance``).
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from math import erf, exp, log1p, pi, sqrt, tanh
from typing import Self

import numpy as np

from invid.effects.effect import ForceEffect
from invid.effects.laws.motor_balance import centred, follow_motor, torque_of_chain
from invid.effects.motion import View
from invid.model.document import EffectTerm
from invid.model.place import Place
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.compiled import compiled
from invid.signals.standstill import sign_threshold

ROUNDING = "rounding"
"""Name of the additional parameter of friction in a model whose sign changes gradually."""
SATURATION = 15.0
"""Velocity over the softness from which the sign is one (exp(−30) is below the resolution of a float)."""

FOLLOWED, SEEN = 20.0, 0.5
"""Speed below which a motor is followed, over the softness of a reversal, and over the rms velocity at most.
Empirical, on simulated motors with 43 to 50 dB of friction: from 10 to 30 softnesses what is left changes by
a tenth; at 4 and less the noise of the velocity decides when a motor stops."""
STEPS = 33
"""Speeds from rest to there at which a law is tabulated."""


class DryLaw(ForceEffect):
    """A friction law that depends on the sign of the velocity, abruptly or over a range of velocity."""

    answered = True
    rounding: float = 0.0
    """Velocity over which the sign changes, tanh(v/rounding) [rad/s or m/s]; 0: abruptly. Physical: creep and
    lubricant round the corner of every contact."""

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
        """Velocity over which the sign changes: the rounding, or the velocity's noise if larger."""
        v = view.velocity(place.pattern(view.structure))
        return max(sign_threshold(v, float(view.record.velocity_noise[place.axis])), self.rounding)

    def stands(self, view: View, place: Place) -> bool:
        return self._is_followed(view, place) and view.record.standing[place.axis]

    def resists(self, v: Float64, x: Sequence[float]) -> Float64:
        """(n,) resistance at velocities ``v`` (n,) other than zero."""
        raise NotImplementedError

    def resistance_at(self, v: Float64, soft: float, shape: Sequence[float]) -> Float64:
        """(n, L) mean resistance around each sample of velocities ``v`` (n,), each coefficient at one."""
        raise NotImplementedError

    def law(self, view: View, place: Place, shape: Sequence[float]) -> Float64:
        v = view.velocity(place.pattern(view.structure))
        return self.resistance_at(v, self.softness(view, place), shape)

    def contribution(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[Complex128, Complex128 | None]:
        if not self._is_followed(view, place):
            return super().contribution(view, place, x)
        pattern, fine = place.pattern(view.structure), view.on_fine_grid()
        if self.stands(view, place):
            mean, _ = self._balance(fine, place, x)
        else:  # when it turns round hardly changes with inner motion
            key = (self, place, tuple(x), view.beside)
            mean, _ = view.cached(key, lambda: self._balance(fine, place, x))
        # A mean over the two intervals around each sample.
        spread = np.sinc(view.omega * fine.record.wave_step / np.pi)
        force = fine.to_lines(centred(mean, fine)[:, None]) / spread[:, None]
        return view.condensed_force(pattern) * force, -view.inner_receptance(pattern) * force

    def _balance(self, view: View, place: Place, x: Sequence[float]) -> tuple[Float64, Float64]:
        """(n,) mean friction over the interval after each sample, and (n,) the share in which it holds."""
        record, axis = view.record, place.axis
        v = view.velocity(place.pattern(view.structure))
        slow = FOLLOWED * self.softness(view, place)
        speeds = np.linspace(1e-9, 1.0, STEPS) * slow
        forward, backward = self.resists(speeds, x), self.resists(-speeds, x)
        drive, rest = view.drive_means(axis), torque_of_chain(view, axis)
        rest = rest - sum((b.over_time(view) for b in view.beside if b.axis == axis), np.zeros(rest.size))
        lightness = 1.0 / float(view.masses[view.structure.motor_dofs[axis]])

        def follow(velocity: Float64) -> tuple[Float64, Float64]:
            found: tuple[Float64, Float64] = follow_motor(
                velocity, self.resists(velocity, x), drive, rest, forward, backward, slow, lightness,
                record.wave_step,
            )  # fmt: skip
            return found

        mean, share = follow(np.ascontiguousarray(v))
        if record.transient or not record.unseen.size:
            return mean, share
        left = centred(drive.mean(axis=1) - mean, view)
        return follow(v + lightness * record.unseen_speed(left, axis))

    def holding_share(self, view: View, place: Place, x: Sequence[float]) -> Float64 | None:
        """(n,) share of each sample in which friction balances all torques on a standing motor; ``None``
        without standstill."""
        if not self.stands(view, place):
            return None
        return centred(self._balance(view, place, x)[1], view)

    def _is_followed(self, view: View, place: Place) -> bool:
        """Return whether it sits at a motor whose velocity stands out of its noise, and changes over at
        once.
        """
        if place.kind != "mass" or place.number != 1 or self.rounding > 0.0:
            return False
        v = view.velocity(place.pattern(view.structure))
        return FOLLOWED * self.softness(view, place) < SEEN * float(np.sqrt(np.mean(v**2)))


@compiled
def mean_between(v: np.ndarray, phi: np.ndarray, plain: np.ndarray) -> np.ndarray:
    """(n,) mean over the intervals around each sample of a wave that closes.

    ``phi`` (n,) is the law's antiderivative and ``plain`` (n,) the law itself, at the velocities ``v`` (n,).
    """
    count = v.size
    small = 1e-9 * np.abs(v).max()
    out = np.empty(count)
    before = 0.0
    for k in range(-1, count):
        a = k if k >= 0 else count - 1
        b = k + 1 if k + 1 < count else 0
        dv = v[b] - v[a]
        now = 0.5 * (plain[a] + plain[b]) if abs(dv) <= small else (phi[b] - phi[a]) / dv
        if k >= 0:
            out[k] = 0.5 * (before + now)
        before = now
    return out


@compiled
def _mean_sign(v: np.ndarray, soft: float) -> np.ndarray:
    phi, plain = np.empty(v.size), np.empty(v.size)
    for k in range(v.size):
        u = abs(v[k]) / soft
        near = u < SATURATION
        phi[k] = soft * (u + (log1p(exp(-2.0 * u)) if near else 0.0))
        size = tanh(u) if near else 1.0
        plain[k] = size if v[k] > 0 else -size
    return mean_between(v, phi, plain)


@compiled
def _mean_excess(v: np.ndarray, soft: float, width: float) -> np.ndarray:
    phi, plain = np.empty(v.size), np.empty(v.size)
    for k in range(v.size):
        u, w = abs(v[k]) / soft, abs(v[k]) / width
        # What the sign has not reached yet where it changes over, as if the bend were one there.
        late = soft * (log1p(exp(-2.0 * u)) if u < SATURATION else 0.0)
        phi[k] = width * sqrt(pi) / 2 * erf(w) + late
        size = (tanh(u) if u < SATURATION else 1.0) * exp(-w * w)
        plain[k] = size if v[k] > 0 else -size
    return mean_between(v, phi, plain)


@compiled
def _mean_clipped(d: np.ndarray, half: float) -> np.ndarray:
    phi, plain = np.empty(d.size), np.empty(d.size)
    for k in range(d.size):
        u = abs(d[k])
        phi[k] = 0.5 * u * u if u < half else half * (u - 0.5 * half)
        plain[k] = min(max(d[k], -half), half)
    return mean_between(d, phi, plain)


def clip_law(d: Float64, half: float) -> Float64:
    """(n,) the deflection, limited to ±half."""
    out: Float64 = _mean_clipped(np.ascontiguousarray(d), half)
    return out


def sign_law(v: Float64, soft: float) -> Float64:
    """(n,) the sign of the velocity, tanh(v/soft)."""
    out: Float64 = _mean_sign(np.ascontiguousarray(v), soft)
    return out


def excess_law(v: Float64, soft: float, width: float) -> Float64:
    """(n,) sign(v)·exp(−(v/width)²)."""
    out: Float64 = _mean_excess(np.ascontiguousarray(v), soft, width)
    return out


@compiled
def _mean_even(v: np.ndarray, soft: float) -> np.ndarray:
    phi, plain = np.empty(v.size), np.empty(v.size)
    for k in range(v.size):
        u = v[k] / soft
        size = tanh(u) if abs(u) < SATURATION else (1.0 if u > 0 else -1.0)
        phi[k], plain[k] = v[k] - soft * size, size * size
    return mean_between(v, phi, plain)


def even_law(v: Float64, soft: float) -> Float64:
    """(n,) the square of the sign: one, except where it changes."""
    out: Float64 = _mean_even(np.ascontiguousarray(v), soft)
    return out


def stribeck_decay(velocity: Float64, shape: Sequence[float]) -> Float64:
    """(n,) exp(−(|v|/v₀)^exponent), ``shape`` (v₀, exponent): the part of friction at low speed alone."""
    out: Float64 = np.exp(-((np.abs(velocity) / (shape[0] or 1.0)) ** max(int(shape[1]), 1)))
    return out
