"""Laws linearised at the present motion: the change of their forces with inner motion.

Where a record closes, a law of the motion at the same time is a product over time and so a convolution over
the lines: a Toeplitz and a Hankel matrix, both from one Fourier transform of its slope.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from invid.effects.catalogue.backlash import Backlash, spring_index
from invid.effects.catalogue.transmission_error import TransmissionError
from invid.effects.effect import ForceEffect, ImpedanceEffect
from invid.effects.laws.beyond_band import PASSES as BEYOND_PASSES
from invid.effects.laws.beyond_band import motion_of_force, solve_with_motion
from invid.effects.laws.sign import DryLaw, clip_law
from invid.effects.motion import View, along
from invid.likelihood.placed_effect import Candidate, PlacedEffect
from invid.model.place import Pattern
from invid.numerics.arrays import Bool, Complex128, Float64

DIFFERENCE = 1e-6
"""Finite difference of one sample of motion, over the rms of the motion, for the slope of a local law."""


@dataclass(frozen=True, eq=False)
class ForceChange:
    """Direct changes with P parameters at fixed forces."""

    base: Complex128
    """(F, ΣN, P) motion of the linear plant."""
    missing: Complex128
    """(F, M, P) missing torque of the linear plant."""
    springs: Float64
    """(springs, P), stiffness; ``dampers`` (springs, P)."""
    dampers: Float64
    total: Complex128
    """(F, M, P) contributions of the effects."""
    back: Complex128
    """(F, ΣN, P) inner motion that follows from them."""

    def only(self, columns: Bool) -> ForceChange:
        """The change with some of the parameters."""
        return ForceChange(*(getattr(self, f.name)[..., columns] for f in fields(self)))


@dataclass(frozen=True, eq=False)
class Factors:
    """A slope as a product: f = made · (Re(read · u) + direct), with u (F,) the change of a motion that the
    law reads, f (F,) that of the force, and r numbers between."""

    read: tuple[tuple[Pattern, Complex128], ...]
    """(r, F) of the motion along each pattern that the law reads."""
    made: Complex128
    """(F, r)."""
    direct: Float64
    """(r, P) direct change with the springs and dampers."""

    def between(self, motion: Complex128) -> Float64:
        """(r, P) numbers between for a motion (F, ΣN, P) of all coordinates, without the direct change."""
        out: Float64 = np.sum([(read @ along(pattern, motion)).real for pattern, read in self.read], axis=0)
        return out


class LawSlope(Protocol):
    """A law linearised at the present motion: change of force with a change of motion."""

    def force(self, view: View, change: ForceChange, inner: Complex128, jumps: Float64) -> Complex128:
        """(F, P) lines of the force along the place."""
        ...

    @property
    def acts_on(self) -> Pattern:
        """Pattern along which the force acts."""
        ...

    def factors(self, view: View, change: ForceChange) -> Factors | None:
        """The slope as a product where the record closes; ``None`` where it is no product over time."""
        ...


def slopes_of(view: View, candidate: Candidate) -> list[LawSlope] | None:
    """The laws that depend on inner motion, linearised; ``None`` where one has no slope by itself.

    Such a law has memory or is estimated from the torque.
    """
    out: list[LawSlope] = []
    for term, x in zip(candidate.terms, candidate.x, strict=True):
        effect = term.effect
        if isinstance(effect, ImpedanceEffect):
            if not effect.steady:
                return None
        elif term.depends_on_inner_motion(view) and not effect.follows_motor(term.place):
            slopes = _slopes_of_law(view, term, x)
            if not slopes:
                return None
            out += slopes
    return out


def _slopes_of_law(view: View, term: PlacedEffect, x: Float64) -> Sequence[LawSlope]:
    """The forces of one law, linearised; empty where it has no slope by itself."""
    effect, place = term.effect, term.place
    if view.record.lines[-1] * 2 >= view.record.samples:
        return ()
    if isinstance(effect, DryLaw) and (share := effect.holding_share(view, place, x.tolist())) is not None:
        return (HeldMotor.of(view, share, place.axis),)
    if type(effect) is Backlash:
        return (PlaySlope.of(view, term, float(np.exp(x[0]))),)
    if type(effect) is TransmissionError:
        return GearSlope.of(view, effect, term, x)
    if not (isinstance(effect, ForceEffect) and effect.local and term.inner):
        return ()
    return (LocalLaw.of(view, effect, term, x),)


@dataclass(frozen=True, eq=False)
class HeldMotor:
    """Friction that holds a standing motor: it balances the torque of the motor's spring up to its limit."""

    acts_on: Pattern
    pattern: Pattern
    """Deflection of the spring beside it, which it reads."""
    spring: int
    phase: Complex128
    """(m, F) e^{jωt} at the samples at which it holds."""
    share: Float64
    """(m,) share of each sample in which it holds."""
    time: Float64
    ends: tuple[bool, bool]
    """Whether the first and the last sample of the record are among them."""
    wave: Float64
    rate: Float64

    @classmethod
    def of(cls, view: View, share: Float64, axis: int) -> HeldMotor:
        """``share`` (n,) of each sample in which friction balances the acting torque."""
        structure, record = view.structure, view.record
        at = structure.motor_dofs[axis]
        motor: Pattern = ((at, 1.0),)
        pattern, spring = motor, 0
        if structure.sizes[axis] == 1:
            share = np.zeros_like(share)  # what acts is the drive's torque alone
        else:
            pattern = ((at + 1, 1.0), (at, -1.0))
            spring = structure.spring_pairs.index((at, at + 1))
        rows = np.flatnonzero(share)
        return cls(
            motor,
            pattern,
            spring,
            np.exp((2j * np.pi / record.samples) * rows[:, None] * record.lines),
            share[rows],
            record.wave_time[rows],
            (bool(rows.size) and rows[0] == 0, bool(rows.size) and rows[-1] == record.samples - 1),
            view.wave(pattern)[rows] if rows.size else np.zeros(0),
            view.velocity(pattern)[rows] if rows.size else np.zeros(0),
        )

    def force(self, view: View, change: ForceChange, inner: Complex128, jumps: Float64) -> Complex128:
        record, omega = view.record, view.omega
        if not self.share.size:
            return np.zeros((omega.size, inner.shape[-1]), dtype=complex)
        k, d = float(view.springs[self.spring]), float(view.dampers[self.spring])
        lines, wander = motion_along(view, self.pattern, inner, jumps)
        torque = (self.phase @ ((k + 1j * omega * d)[:, None] * lines)).real
        torque += (k * self.time + d)[:, None] * wander
        torque += self.wave[:, None] * change.springs[self.spring]
        torque += self.rate[:, None] * change.dampers[self.spring]
        held = self.share[:, None] * torque
        out: Complex128 = (self.phase.conj().T @ held) * (2.0 / record.samples)
        if record.transient:
            first, last = held[0] * self.ends[0], held[-1] * self.ends[1]
            out = out + (last - first) / record.samples
        out[0] *= 0.5
        return out / view.averaging_gain[:, None]

    def factors(self, view: View, change: ForceChange) -> Factors | None:
        record, omega = view.record, view.omega
        if not self.share.size:
            none = np.zeros((0, omega.size), dtype=complex)
            return Factors(((self.pattern, none),), none.T, np.zeros((0, change.springs.shape[1])))
        k, d = float(view.springs[self.spring]), float(view.dampers[self.spring])
        made: Complex128 = self.phase.conj().T * self.share * (2.0 / record.samples)
        made[0] *= 0.5
        direct = self.wave[:, None] * change.springs[self.spring]
        direct = direct + self.rate[:, None] * change.dampers[self.spring]
        read: Complex128 = self.phase * (k + 1j * omega * d)
        return Factors(((self.pattern, read),), made / view.averaging_gain[:, None], direct)


@dataclass(frozen=True, eq=False)
class LocalLaw:
    """A law of the motion at the same time or at neighbouring samples, beyond the band too."""

    acts_on: Pattern
    """Pattern along which it reads motion as well."""
    smeared: bool
    compliance: Float64 | None
    position: tuple[Float64, Float64, Float64]
    """(n,) each: change of the force at the sample before, at and after the one that moves."""
    velocity: tuple[Float64, Float64, Float64]

    @classmethod
    def of(cls, view: View, effect: ForceEffect, term: PlacedEffect, x: Float64) -> LocalLaw:
        count, pattern = len(effect.coefficients), term.place.pattern(view.structure)

        def law() -> Float64:
            out: Float64 = effect.law(view, term.place, x[count:].tolist()) @ x[:count]
            return out

        compliance = effect.compliance_beyond_band(view, term.place)
        try:
            if compliance is not None:
                view.set_hidden_motion(pattern, solve_with_motion(view, pattern, compliance, law)[1])
            found = [_slopes_over_time(view, pattern, rate, law) for rate in (False, True)]
        finally:
            view.set_hidden_motion(pattern, None)
        return cls(pattern, effect.smeared, compliance, found[0], found[1])

    def factors(self, view: View, change: ForceChange) -> Factors | None:
        if self.compliance is not None or view.record.transient:
            return None
        own = 1j * view.omega
        same, mirrored = _convolution(view, self.position)
        if any(w.any() for w in self.velocity):
            rate, turned = _convolution(view, self.velocity)
            same, mirrored = same + rate * own, mirrored - turned * own
        smear = view.averaging_gain if self.smeared else np.ones(own.size)
        nothing = np.zeros((own.size, change.springs.shape[1]), dtype=complex)
        return _factors_of_lines({self.acts_on: (same / smear[:, None], mirrored / smear[:, None])}, nothing)

    def force(self, view: View, change: ForceChange, inner: Complex128, jumps: Float64) -> Complex128:
        record, own = view.record, 1j * view.omega[:, None]
        lines, wander = motion_along(view, self.acts_on, inner, jumps)
        shape = (record.samples, lines.shape[1])
        position = velocity = np.zeros(shape)  # a law seldom reads both
        if any(s.any() for s in self.position):
            position = record.to_waves(lines) + record.wave_time[:, None] * wander
        if any(s.any() for s in self.velocity):
            velocity = record.to_waves(own * lines) + wander
        force = seen = self._force_along(position, velocity)
        if self.compliance is not None:
            rate = 1j * record.wave_omega[:, None]
            for _ in range(BEYOND_PASSES):
                hidden = motion_of_force(view, self.compliance, force)
                more = (np.fft.irfft(h, record.samples, axis=0) for h in (hidden, rate * hidden))
                force = 0.5 * (force + seen + self._force_along(*more))
        return view.to_lines(force, smeared=self.smeared)

    def _force_along(self, position: Float64, velocity: Float64) -> Float64:
        """(n, P) force for a change of motion over time."""
        return _apply_slopes(self.position, position) + _apply_slopes(self.velocity, velocity)


@dataclass(frozen=True, eq=False)
class PlaySlope:
    """Free play: spring and damper lose the deflection within it."""

    acts_on: Pattern
    """Pattern along which it reads motion as well."""
    spring: int
    inside: Complex128
    """(F,) lines of the deflection that they lose, ``rate`` (F,) those of its rate."""
    rate: Complex128
    position: tuple[Float64, Float64, Float64]

    @classmethod
    def of(cls, view: View, term: PlacedEffect, gap: float) -> PlaySlope:
        pattern = term.place.pattern(view.structure)

        def law() -> Float64:
            return clip_law(view.wave(pattern), 0.5 * gap)

        wave = law()
        lines = view.to_lines(wave[:, None], smeared=True)[:, 0]
        rate = 1j * view.omega * lines
        if view.record.transient:
            rate = rate + (wave[-1] - wave[0]) * (2.0 / view.record.span)
            rate[0] *= 0.5
        return cls(
            pattern, spring_index(view.structure, term.place), lines, rate,
            _slopes_over_time(view, pattern, False, law),
        )  # fmt: skip

    def factors(self, view: View, change: ForceChange) -> Factors | None:
        if view.record.transient:
            return None
        k, d, own = float(view.springs[self.spring]), float(view.dampers[self.spring]), 1j * view.omega
        stiff = -(k + own * d)[:, None] / view.averaging_gain[:, None]
        same, mirrored = _convolution(view, self.position)
        moved = own[:, None] * change.dampers[self.spring] + change.springs[self.spring]
        answer = {self.acts_on: (stiff * same, stiff * mirrored)}
        return _factors_of_lines(answer, -self.inside[:, None] * moved)

    def force(self, view: View, change: ForceChange, inner: Complex128, jumps: Float64) -> Complex128:
        record, omega = view.record, view.omega[:, None]
        inside = _apply_slopes(self.position, wave_along(view, self.acts_on, inner, jumps))
        lost = view.to_lines(inside, smeared=True)
        rate = 1j * omega * lost
        if record.transient:
            rate = rate + (inside[-1] - inside[0]) * (2.0 / record.span)
            rate[0] *= 0.5
        k, d = float(view.springs[self.spring]), float(view.dampers[self.spring])
        out: Complex128 = -(k * lost + d * rate)
        out -= (
            self.inside[:, None] * change.springs[self.spring]
            + self.rate[:, None] * change.dampers[self.spring]
        )
        return out


@dataclass(frozen=True, eq=False)
class GearSlope:
    """One of the two forces of a transmission error: a product over time of the motor side's motion and of
    the deflection."""

    acts_on: Pattern
    slopes: Mapping[Pattern, Float64]
    """(n,) change of the force with the motion along each pattern that it reads."""
    spring: int
    lines: Complex128
    """(F,) of the force of a spring of stiffness one."""

    @classmethod
    def of(cls, view: View, effect: TransmissionError, term: PlacedEffect, x: Float64) -> list[GearSlope]:
        spring = term.place.pattern(view.structure)
        near, far = (((at, 1.0),) for at, _ in spring)
        k = spring_index(view.structure, term.place)
        forces, slopes = effect.unit_forces(view, term.place, x.tolist())
        lines, stiff = view.to_lines(forces), float(view.springs[k])
        by_near = {near: stiff * slopes[:, 0], spring: stiff * slopes[:, 1]}
        return [cls(near, by_near, k, lines[:, 0]), cls(far, {near: stiff * slopes[:, 2]}, k, lines[:, 1])]

    def factors(self, view: View, change: ForceChange) -> Factors | None:
        if view.record.transient:
            return None
        answers = {p: _convolution(view, (np.zeros(0), s, np.zeros(0))) for p, s in self.slopes.items()}
        return _factors_of_lines(answers, self.lines[:, None] * change.springs[self.spring])

    def force(self, view: View, change: ForceChange, inner: Complex128, jumps: Float64) -> Complex128:
        out: Complex128 = self.lines[:, None] * change.springs[self.spring]
        for pattern, slope in self.slopes.items():
            out = out + view.to_lines(slope[:, None] * wave_along(view, pattern, inner, jumps))
        return out


def _apply_slopes(slopes: tuple[Float64, Float64, Float64], wave: Float64) -> Float64:
    """(n, P) change of a law with its wave (n, P); ``slopes`` as of ``_slopes_over_time``."""
    before, at, after = slopes
    out = at[:, None] * wave if at.any() else np.zeros_like(wave)
    for slope, shift in ((before, -1), (after, 1)):
        if slope.any():
            out += np.roll(slope[:, None] * wave, shift, axis=0)
    return out


def _slopes_over_time(
    view: View, pattern: Pattern, rate: bool, law: Callable[[], Float64]
) -> tuple[Float64, Float64, Float64]:
    """(n,) each: change of a law at the sample before, at and after the one whose position (or ``rate``)
    changes."""
    kept, view._waves = view._waves, dict(view._waves)
    wave, rest = view._wave(pattern, rate), law()
    length = DIFFERENCE * max(float(np.sqrt(np.mean(wave**2))), 1e-300)
    at, before, after = (np.zeros(wave.size) for _ in range(3))
    for mask in _separated_masks(wave.size):
        view._waves[(pattern, rate)] = wave + length * mask
        change = (law() - rest) / length
        moved = np.flatnonzero(mask)
        at[moved] = change[moved]
        before[moved] = change[moved - 1]
        after[moved] = change[(moved + 1) % wave.size]
    view._waves = kept
    return before, at, after


def _convolution(view: View, slopes: tuple[Float64, Float64, Float64]) -> tuple[Complex128, Complex128]:
    """(F, F) twice: factors of the motion's lines and of their conjugates in the lines of the force."""
    count, lines = view.record.samples, view.record.lines
    same: Complex128 = np.zeros((lines.size, lines.size), dtype=complex)
    mirrored: Complex128 = np.zeros_like(same)
    for slope, shift in zip(slopes, (-1, 0, 1), strict=True):
        if not slope.any():
            continue
        spectrum = np.fft.fft(slope)
        turn = np.exp((-2j * np.pi * shift / count) * lines)[:, None]
        same += turn * spectrum[(lines[:, None] - lines) % count]
        mirrored += turn * spectrum[(lines[:, None] + lines) % count]
    same[0] *= 0.5
    mirrored[0] *= 0.5
    return same / count, mirrored / count


def _factors_of_lines(
    answers: Mapping[Pattern, tuple[Complex128, Complex128]], direct: Complex128
) -> Factors:
    """Factors with the real and imaginary parts of the force's lines as the numbers between; ``answers`` to
    the motion along each pattern as of ``_convolution``."""
    # Re(S x̄) = Re(S̄ x), and an imaginary part is a real one of −j times.
    read = tuple(
        (pattern, np.concatenate((same + mirrored.conj(), 1j * (mirrored.conj() - same))))
        for pattern, (same, mirrored) in answers.items()
    )
    made = np.concatenate((np.eye(direct.shape[0]), 1j * np.eye(direct.shape[0])), axis=1)
    return Factors(read, made, np.concatenate((direct.real, direct.imag)))


def _separated_masks(count: int) -> list[Float64]:
    """Masks (n,) whose samples are at least three apart, around the end too."""
    number = np.arange(count) % 3
    for k in range(count % 3):
        number[count - 1 - k] = 3 + k
    return [(number == k).astype(float) for k in np.unique(number)]


def motion_along(
    view: View, pattern: Pattern, inner: Complex128, jumps: Float64
) -> tuple[Complex128, Float64]:
    """(F, P) lines along a place, and (P,) its mean rate over a record that does not close."""
    lines = along(pattern, inner)
    if view.closing is None:
        return lines, np.zeros(inner.shape[-1])
    slopes = jumps[: inner.shape[1]] / view.record.span
    wander = np.asarray(sum(sign * slopes[at] for at, sign in pattern))
    return lines + along(pattern, view.closing.inner) @ jumps - view.slope * wander, wander


def wave_along(view: View, pattern: Pattern, inner: Complex128, jumps: Float64) -> Float64:
    """(n, P) the same over time."""
    lines, wander = motion_along(view, pattern, inner, jumps)
    return view.record.to_waves(lines) + view.record.wave_time[:, None] * wander
