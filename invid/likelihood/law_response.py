"""Derivatives of what effects contribute, inner motion in agreement: all parameters at once.

At the inner motion q that laws f and plant agree on, q = q₀(θ) − Z_ii⁻¹ B f(q, θ), the implicit function
theorem gives dq = (1 + Z_ii⁻¹ B ∂f/∂q Bᵀ)⁻¹ (∂q₀/∂θ − Z_ii⁻¹ B ∂f/∂θ). The laws are looked at once, at the
motion there is; what they do to every parameter is then a product of matrices. How a motor that stands moves
the reversals before and after is left out: it is beyond the band, and the search does not miss it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from invid.effects.effect import ForceEffect, ImpedanceEffect
from invid.effects.laws.beyond_band import PASSES as BEYOND_PASSES
from invid.effects.laws.beyond_band import answer, beyond_band
from invid.effects.laws.sign import DryLaw
from invid.effects.motion import View, along
from invid.likelihood.placed_effect import Candidate, Term, law_part, law_parts, together
from invid.model.place import Pattern
from invid.numerics.anderson import Secants
from invid.numerics.arrays import Bool, Complex128, Float64

STEP = 1e-6
"""Difference of a sample of motion, over the rms of the motion, that a local law's slope is taken with."""
PASSES = 12
"""Substitutions at most; with what each has taught the next, two or three are enough for weak effects."""
PLAIN = 4
"""Substitutions before what they taught is put to use: weak effects need no more."""
CLOSE = 1e-3
"""Disagreement over what was asked for, column by column, that a derivative may have: as good as a
difference, and a step of the search needs no more."""


class _Slope(Protocol):
    """A law around the motion there is: the force that a change of motion makes."""

    def force(self, view: View, change: Change, inner: Complex128, jumps: Float64) -> Complex128:
        """(F, P) lines of the force along the place."""
        ...


@dataclass(frozen=True, eq=False)
class Change:
    """What P parameters change at the forces there are."""

    base: Complex128
    """(F, ΣN, P) motion of the linear plant."""
    missing: Complex128
    """(F, M, P) missing torque of it."""
    springs: Float64
    """(springs, P), stiffness; ``dampers`` (springs, P)."""
    dampers: Float64
    total: Complex128
    """(F, M, P) what the effects contribute."""
    back: Complex128
    """(F, ΣN, P) inner motion that follows from it."""

    def only(self, columns: Bool) -> Change:
        """Some of the parameters."""
        return Change(*(getattr(self, f.name)[..., columns] for f in fields(self)))


def slopes_of(view: View, candidate: Candidate) -> list[tuple[Term, _Slope]] | None:
    """The laws that feel inner motion, each around the motion there is; ``None`` where one of them has no
    slope by itself: it remembers, or is read from the torque."""
    out: list[tuple[Term, _Slope]] = []
    for term, x in zip(candidate.terms, candidate.x, strict=True):
        effect = term.effect
        if isinstance(effect, ImpedanceEffect):
            if not effect.steady:
                return None
        elif term.feels(view):
            slope = _slope(view, term, x)
            if slope is None:
                return None
            out.append((term, slope))
    return out


def _slope(view: View, term: Term, x: Float64) -> _Slope | None:
    effect, place = term.effect, term.place
    if view.record.lines[-1] * 2 >= view.record.samples:
        return None
    if isinstance(effect, DryLaw) and (share := effect.holding(view, place, x.tolist())) is not None:
        return _Holding.of(view, share, place.axis)
    if not (isinstance(effect, ForceEffect) and effect.local and term.inner):
        return None
    return _Local.of(view, effect, term, x)


@dataclass(frozen=True, eq=False)
class _Holding:
    """Friction that holds a motor: where it stands, the torque of its spring, as far as it is not beyond."""

    pattern: Pattern
    spring: int
    phase: Complex128
    """(m, F) e^{jωt} at the samples at which it holds."""
    share: Float64
    """(m,) of each sample."""
    time: Float64
    ends: tuple[bool, bool]
    """Whether the first and the last sample of the record are among them."""
    wave: Float64
    rate: Float64

    @classmethod
    def of(cls, view: View, share: Float64, axis: int) -> _Holding | None:
        """``share`` (n,) of each sample in which friction takes whatever acts."""
        structure, record = view.structure, view.record
        at = structure.motor_dofs[axis]
        if structure.sizes[axis] == 1:
            share = np.zeros_like(share)  # what acts is the drive's torque alone
        rows = np.flatnonzero(share)
        pattern: Pattern = ((at + 1, 1.0), (at, -1.0))
        spring = structure.spring_pairs.index((at, at + 1)) if structure.sizes[axis] > 1 else 0
        return cls(
            pattern,
            spring,
            np.exp((2j * np.pi / record.samples) * rows[:, None] * record.lines),
            share[rows],
            record.wave_time[rows],
            (bool(rows.size) and rows[0] == 0, bool(rows.size) and rows[-1] == record.samples - 1),
            view.wave(pattern)[rows] if rows.size else np.zeros(0),
            view.velocity(pattern)[rows] if rows.size else np.zeros(0),
        )

    def force(self, view: View, change: Change, inner: Complex128, jumps: Float64) -> Complex128:
        record, omega = view.record, view.omega
        if not self.share.size:
            return np.zeros((omega.size, inner.shape[-1]), dtype=complex)
        k, d = float(view.springs[self.spring]), float(view.dampers[self.spring])
        lines, wander = _motion(view, self.pattern, inner, jumps)
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
        return out / view.smear[:, None]


@dataclass(frozen=True, eq=False)
class _Local:
    """A law of the motion at the same time, or at the samples beside it, beyond the band too."""

    pattern: Pattern
    smeared: bool
    compliance: Float64 | None
    position: tuple[Float64, Float64, Float64]
    """(n,) each: change of the force at the sample before, at and after the one that moves."""
    velocity: tuple[Float64, Float64, Float64]

    @classmethod
    def of(cls, view: View, effect: ForceEffect, term: Term, x: Float64) -> _Local:
        count, pattern = len(effect.coefficients), term.place.pattern(view.structure)
        kept = dict(view._waves)
        waves = {rate: (view.velocity if rate else view.wave)(pattern) for rate in (False, True)}

        def law() -> Float64:
            out: Float64 = effect.law(view, term.place, x[count:].tolist()) @ x[:count]
            return out

        compliance = beyond_band(view, term.place) if effect.answered else None
        if compliance is not None:
            view.hide(pattern, answer(view, pattern, compliance, law)[1])
        rest = law()
        found = []
        for rate in (False, True):
            wave = waves[rate]
            length = STEP * max(float(np.sqrt(np.mean(wave**2))), 1e-300)
            at, before, after = (np.zeros(wave.size) for _ in range(3))
            for mask in _apart(wave.size):
                view._waves[(pattern, rate)] = wave + length * mask
                change = (law() - rest) / length
                moved = np.flatnonzero(mask)
                at[moved] = change[moved]
                before[moved] = change[moved - 1]
                after[moved] = change[(moved + 1) % wave.size]
            view._waves[(pattern, rate)] = wave
            found.append((before, at, after))
        view._waves = kept
        view.hide(pattern, None)
        return cls(pattern, effect.smeared, compliance, found[0], found[1])

    def force(self, view: View, change: Change, inner: Complex128, jumps: Float64) -> Complex128:
        record, own = view.record, 1j * view.omega[:, None]
        lines, wander = _motion(view, self.pattern, inner, jumps)
        position = record.to_waves(lines) + record.wave_time[:, None] * wander
        force = seen = self._along(position, record.to_waves(own * lines) + wander)
        if self.compliance is not None:
            rate = 1j * record.wave_omega[:, None]
            for _ in range(BEYOND_PASSES):
                hidden = -self.compliance[:, None] * np.fft.rfft(force, axis=0)
                more = (np.fft.irfft(h, record.samples, axis=0) for h in (hidden, rate * hidden))
                force = 0.5 * (force + seen + self._along(*more))
        return view.to_lines(force, smeared=self.smeared)

    def _along(self, position: Float64, velocity: Float64) -> Float64:
        """(n, P) force for a change of motion over time."""
        force = np.zeros_like(position)
        for wave, (before, at, after) in ((position, self.position), (velocity, self.velocity)):
            force += at[:, None] * wave
            for slope, shift in ((before, -1), (after, 1)):
                if slope.any():
                    force += np.roll(slope[:, None] * wave, shift, axis=0)
        return force


def _apart(count: int) -> list[Float64]:
    """Masks (n,) whose samples have two others between them, around the end too."""
    number = np.arange(count) % 3
    for k in range(count % 3):
        number[count - 1 - k] = 3 + k
    return [(number == k).astype(float) for k in np.unique(number)]


def _motion(view: View, pattern: Pattern, inner: Complex128, jumps: Float64) -> tuple[Complex128, Float64]:
    """(F, P) lines along a place, and (P,) the rate at which it wanders besides."""
    lines = along(pattern, inner)
    if view.closing is None:
        return lines, np.zeros(inner.shape[-1])
    slopes = jumps[: inner.shape[1]] / view.record.span
    wander = np.asarray(sum(sign * slopes[at] for at, sign in pattern))
    return lines + along(pattern, view.closing.inner) @ jumps - view.slope * wander, wander


def respond(
    view: View, candidate: Candidate, slopes: Sequence[tuple[Term, _Slope]], change: Change
) -> Complex128:
    """(F, M, P) what the effects contribute once inner motion has followed the ``change``.

    The view's secants start the substitutions; each pass teaches the next (Anderson's mixing over all columns
    together, because all have the same matrix).
    """
    linear = _Linear(view, candidate, slopes)
    columns = change.base.shape[-1]
    active = np.arange(columns)
    state = np.zeros((linear.rows, columns))
    secants, before = view.secants, None
    asked = best = np.full(columns, np.inf)
    total = np.zeros_like(change.total)
    for number in range(PASSES):
        contributed, gap = linear.gap(state, change)
        size = np.linalg.norm(gap, axis=0)
        if number == 0:
            asked, best = size, best.copy()
        better = size < best[active]
        best[active[better]] = size[better]
        total[..., active[better]] = contributed[..., better]
        if before is not None and number >= PLAIN:
            secants = _taught(secants, state - before[0], gap - before[1])
        far = np.isfinite(size) & (best[active] > CLOSE * asked[active])
        if not far.any():
            break
        active, change, state, gap = active[far], change.only(far), state[:, far], gap[:, far]
        before = (state, gap)
        state = state + secants.step(gap)
    return total


def _taught(secants: Secants, moves: Float64, changes: Float64) -> Secants:
    """With the moves of all columns and what they changed."""
    return Secants.of((*secants.moves, *moves.T), (*secants.changes, *changes.T))


class _Linear:
    """The laws and the plant around the motion there is, as a linear map of inner motion and jumps."""

    def __init__(self, view: View, candidate: Candidate, slopes: Sequence[tuple[Term, _Slope]]) -> None:
        self._view, self._slopes = view, slopes
        self._lines, self._coordinates = view.base.shape
        self._unit: Float64 = view.closing.unit if view.closing is not None else np.zeros(0)
        self._patterns = tuple(
            t.place.pattern(view.structure)
            for t in candidate.terms
            if t.place.kind != "axis" and t.effect.along_pattern
        )
        self._gain = view.correction_gain(self._patterns) if slopes and self._patterns else None
        pairs = zip(candidate.terms, candidate.x, strict=True)
        self._impedances = [
            (t.effect.impedance(view, t.place, x.tolist()), t.place.pattern(view.structure))
            for t, x in pairs
            if isinstance(t.effect, ImpedanceEffect)
        ]
        if self._impedances:
            patterns = [p for _, p in self._impedances]
            self._push = np.stack([view.push(p) for p in patterns], axis=-1)
            self._yields = np.stack([view.yields(p) for p in patterns], axis=-1)
            rows = [z[:, None] * along(p, self._yields) for z, p in self._impedances]
            self._meet = np.linalg.inv(np.eye(len(rows)) + np.stack(rows, axis=1))

    @property
    def rows(self) -> int:
        """Real numbers of inner motion and jumps."""
        count: int = 2 * self._lines * self._coordinates + self._unit.size
        return count

    def gap(self, state: Float64, change: Change) -> tuple[Complex128, Float64]:
        """(F, M, P) contributions at ``state`` (rows, P), and (rows, P) how far it is from what follows."""
        view = self._view
        columns = state.shape[1]
        lines = 2 * self._lines * self._coordinates
        halves = state[:lines].reshape(self._lines, self._coordinates, 2, columns)
        feedback = halves[:, :, 0] + 1j * halves[:, :, 1]
        jumps = state[lines:] / self._unit[:, None]
        own: Complex128 = np.zeros_like(change.total)
        back: Complex128 = np.zeros_like(change.back)
        inner = change.base + feedback
        for term, slope in self._slopes:
            force = slope.force(view, change, inner, jumps)
            pattern = term.place.pattern(view.structure)
            own += view.push(pattern)[:, :, None] * force[:, None, :]
            back -= view.yields(pattern)[:, :, None] * force[:, None, :]
        if self._impedances:
            asked = np.stack([z[:, None] * along(p, back) for z, p in self._impedances], axis=1)
            forces = self._meet @ asked
            own += self._push @ forces
            back -= self._yields @ forces
        if self._gain is not None:
            rest = change.missing + own
            if view.closing is not None:
                rest = rest + view.closing.torque @ view.closing.follow(rest)
            forces = self._gain @ rest
            for k, pattern in enumerate(self._patterns):
                back -= view.yields(pattern)[:, :, None] * forces[:, k, None, :]
        total, back = own + change.total, back + change.back
        gap = np.empty_like(state)
        disagree = back - feedback
        gap[:lines] = np.stack((disagree.real, disagree.imag), axis=2).reshape(lines, columns)
        if view.closing is not None:
            followed = view.closing.follow(change.missing + total)
            gap[lines:] = (followed - jumps) * self._unit[:, None]
        return total, gap


def direct_changes(
    view: View, candidate: Candidate, steps: Sequence[tuple[int, int, float]]
) -> tuple[Complex128, Complex128]:
    """(F, M, P) contributions and (F, ΣN, P) inner motion that follow from each parameter of effects at the
    motion there is, by differences; ``steps`` are effect, number of the parameter and difference."""
    view.forget_measured()  # both sides from the same inner motion
    parts = law_parts(view, candidate)
    total, back = together(view, candidate, parts)
    totals, backs = [], []
    for number, k, h in steps:
        moved = candidate.x[number].copy()
        moved[k] += h
        x = (*candidate.x[:number], moved, *candidate.x[number + 1 :])
        # The other laws stand where they are: what they contribute is known.
        own = law_part(view, candidate.terms[number], moved)
        changed = (*parts[:number], own, *parts[number + 1 :])
        there = together(view, Candidate(candidate.terms, x), changed)
        totals.append((there[0] - total) / h)
        backs.append((there[1] - back) / h)
    return np.stack(totals, axis=-1), np.stack(backs, axis=-1)
