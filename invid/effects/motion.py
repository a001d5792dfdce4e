"""One record through one linear plant: its motion, its missing torque, and the forces that explain it."""

from __future__ import annotations

import copy
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np

from invid.model.parameters import ChainStructure
from invid.model.place import Pattern
from invid.numerics.anderson import Secants
from invid.numerics.arrays import Complex128, Float64
from invid.signals.spectral_record import SpectralRecord

T = TypeVar("T")
CACHE_SIZE = 32
"""Most laws of measured motion that a record keeps: more than act at once, few beside its spectra."""


@dataclass(frozen=True, eq=False)
class Closing:
    """Linear map from the missing torque of a record that does not close to the jumps of its ends."""

    inner: Complex128
    """(F, ΣN, 2ΣN) motion of every coordinate for a unit jump of each."""
    gain: Complex128
    """(2ΣN, F, M): jumps = Re(gain · missing torque)."""
    torque: Complex128
    """(F, M, 2ΣN) missing torque for a unit jump of each."""
    linear: Complex128
    """(F, M) missing torque of the linear model."""

    @cached_property
    def unit(self) -> Float64:
        """(2ΣN,) largest line of motion for a unit jump, which expresses jumps in units of motion."""
        out: Float64 = np.abs(self.inner).max(axis=(0, 1)) + 1e-300
        return out

    def jumps_of(self, missing: Complex128) -> Float64:
        """(2ΣN, P) jumps for missing torque (F, M, P)."""
        out: Float64 = np.tensordot(self.gain, missing, axes=((1, 2), (0, 1))).real
        return out

    def missing_with(self, extra: Complex128) -> Complex128:
        """(F, M) missing torque with ``extra`` (F, M) of effects, the part that the ends explain projected
        out."""
        out: Complex128 = self.linear + extra + self.torque @ self.jumps(extra)
        return out

    def jumps(self, extra: Complex128) -> Float64:
        """(2ΣN,) jumps with ``extra`` (F, M) contributed by effects."""
        out: Float64 = np.einsum("jfm,fm->j", self.gain, self.linear + extra).real
        return out


class MotorLaw(Protocol):
    """A law of the motion of one motor, with its size."""

    @property
    def axis(self) -> int:
        """Return the number of the motor's axis."""
        ...

    def over_time(self, view: View) -> Float64:
        """(n,) resistance [N·m or N]."""
        ...


@dataclass(frozen=True)
class Equivalent:
    """A spring and a damper in place of a law (equivalent linearisation): the law's mean slope.

    ``law`` tells laws and their sizes apart, coarsely.
    """

    pattern: Pattern
    law: Hashable
    stiffness: float
    damping: float


class View:
    """One record through one linear plant; its waves over time are computed once."""

    def __init__(  # noqa: PLR0913 - what a law may ask of a record
        self,
        record: SpectralRecord,
        structure: ChainStructure,
        motion: Complex128,
        stiffness: Complex128,
        inner: Complex128,
        acting: Complex128,
        springs: Float64,
        dampers: Float64,
        masses: Float64,
        origin: float,
        images: Complex128,
        inertance: Float64,
        couplings: Float64,
        grounds: Float64,
        late: Float64,
    ) -> None:
        self.record, self.structure = record, structure
        self.motion, self.stiffness, self.inner = motion, stiffness, inner
        self.acting = acting
        self.springs, self.dampers, self.masses = springs, dampers, masses
        self.origin = origin
        self.images = images
        """(F, M) torque that images of held torque look like on the lines (``signals.spectral_record``)."""
        self.couplings = couplings
        """(M, M) inertia couplings of the end masses, zero on the diagonal."""
        self.grounds = grounds
        """(M,) stiffness of the springs from the motors to ground."""
        self.late = late
        """(M,) how much later than its samples the held torque of each axis steps [s]."""
        self.inertance = inertance
        """(M, M) acceleration of the motors over their torque far above all modes."""
        self.base = np.einsum("fqm,fm->fq", motion, record.filtered)
        self.feedback: Complex128 = np.zeros_like(self.base)
        self.end_motion: Complex128 = np.zeros_like(self.base)
        """(F, ΣN) motion besides ``base`` due to the ends of a record that does not close."""
        self._end_correction: tuple[Complex128, Float64] | None = None
        """For a record that does not close: inner motion (F, ΣN) besides ``base``, and mean rates (ΣN,)."""
        self.jumps: Float64 = np.zeros(0)
        """(2ΣN,) end minus start of positions, then of velocities, of a record that does not close."""
        self.closing: Closing | None = None
        self.secants = Secants()
        self.may_agree = True
        """Whether Newton's steps have not failed yet to bring forces and inner motion into agreement."""
        self.equivalents: tuple[Equivalent, ...] = ()
        self._response: tuple[Complex128, list[Pattern]] | None = None
        self.starts: dict[Pattern, float] = {}
        """Initial displacements of sliders, over the displacement at which they slide."""
        self.missing: Complex128 | None = None
        """(F, M) missing torque of the linear model; ``None`` where forces cannot be estimated from it."""
        self.certainty: Complex128 = np.zeros((0, 0, 0), dtype=complex)
        """(F, M, M) inverse covariance of ``missing`` and of ``remaining``."""
        self.remaining: Complex128 | None = None
        """(F, M) missing torque without what the chosen causes and the record's ends explain."""
        self.beside: tuple[MotorLaw, ...] = ()
        """Laws at motors other than dry friction, which feels what they take."""
        self._waves: dict[tuple[Pattern, bool], Float64] = {}
        self._laws: dict[Hashable, Any] = {}
        self._gains: dict[tuple[Pattern, ...], Complex128] = {}
        self._hidden_motion: dict[Pattern, Complex128] = {}
        self._condensed_forces: dict[Pattern, Complex128] = {}
        self._inner_receptances: dict[Pattern, Complex128] = {}
        self._cache: dict[Hashable, Any] = {}
        self._fine_cache: dict[Hashable, Any] = {}

    def cached(self, key: Hashable, make: Callable[[], T]) -> T:
        """The value of ``make()``, cached under ``key``.

        For what follows from the motors' measured motion alone, which iterations of inner motion do not
        change.
        """
        out: T = self._cache.pop(key) if key in self._cache else make()
        self._cache[key] = out
        if len(self._cache) > CACHE_SIZE:
            del self._cache[next(iter(self._cache))]
        return out

    def at_motion(self, key: Hashable, make: Callable[[], T]) -> T:
        """The value of ``make()``, kept under ``key`` while the inner motion and the initial states are the
        same."""
        key = (key, *self.starts.items())
        if key not in self._laws:
            self._laws[key] = make()
        out: T = self._laws[key]
        return out

    def clear_cache(self) -> None:
        """Clears the cache: its values may depend a little on the inner motion at that time."""
        self._cache.clear()
        self._fine_cache.clear()

    def set_equivalents(self, equivalents: tuple[Equivalent, ...]) -> None:
        """Sets springs and dampers in place of the laws on inner motion (``without_response``)."""
        self.equivalents, self._response = equivalents, None
        if not equivalents:
            return
        patterns = [e.pattern for e in equivalents]
        yields = np.stack([self.inner_receptance(p) for p in patterns], axis=-1)
        force = np.stack([e.stiffness + 1j * self.omega * e.damping for e in equivalents], axis=-1)
        rows = np.stack([along(p, yields) for p in patterns], axis=1) * force[:, None]
        alone = np.linalg.inv(np.eye(len(patterns)) + rows)
        self._response = (yields * force[:, None]) @ alone, patterns

    def without_response(self, gap: Complex128) -> Complex128:
        """(F, ΣN, …) inner motion from what forces and plant disagree by, less what the laws answer to it.

        Exact for laws that are springs and dampers. Any other answers to a change nearly so, and far less of
        the change is left than by substitution, which diverges where a law is stiffer than the chain.
        """
        if self._response is None:
            return gap
        answer, patterns = self._response
        moved = np.stack([along(p, gap) for p in patterns], axis=1)
        out: Complex128 = gap - (answer @ moved.reshape(*moved.shape[:2], -1)).reshape(gap.shape)
        return out

    def on_fine_grid(self) -> View:
        """The view at its present inner motion with waves on the record's fine grid; itself where there is
        none."""
        if self.record.fine is None:
            return self
        other = copy.copy(self)
        other.record, other._waves, other._laws, other._hidden_motion = self.record.fine, {}, {}, {}
        other._cache, other._fine_cache = self._fine_cache, {}
        other.__dict__.pop("averaging_gain", None)  # of the grid
        return other

    def is_measured(self, pattern: Pattern) -> bool:
        """Return whether the motion along a pattern is that of one motor."""
        return len(pattern) == 1 and pattern[0][0] in self.structure.motor_dofs

    @property
    def omega(self) -> Float64:
        """(F,) angular frequencies [rad/s]."""
        return self.record.omega

    @cached_property
    def unfiltered(self) -> Complex128:
        """(F, ΣN) motion of the linear plant at the measured motor positions, noise not filtered out."""
        out: Complex128 = np.einsum("fqm,fm->fq", self.motion, self.record.position)
        return out

    @cached_property
    def jump_bound(self) -> Float64:
        """(2ΣN,) bound of the jumps between the ends of the record: twice the motion and its rate."""
        size = np.sqrt((np.abs(self.base) ** 2).sum(axis=0))
        rate = np.sqrt((np.abs(self.omega[:, None] * self.base) ** 2).sum(axis=0))
        out: Float64 = 2.0 * np.concatenate((size, rate)) + 1e-300
        return out

    @cached_property
    def averaging_gain(self) -> Float64:
        """(F,) gain of a mean over a triangle of two samples."""
        out: Float64 = np.sinc(self.omega * self.record.wave_step / 2 / np.pi) ** 2
        return out

    def set_inner_motion(self, feedback: Complex128, jumps: Float64 | None = None) -> None:
        """Sets the inner motion (F, ΣN) that all effects cause, and the ``jumps`` (2ΣN,) of a record that
        does not close.

        The ramp between the motors' own ends is in their waves.
        """
        self.feedback, self._laws = feedback, {}
        self._waves = {k: v for k, v in self._waves.items() if self.is_measured(k[0])}
        if self.closing is not None and jumps is not None:
            self.jumps = jumps
            slopes = jumps[: self.base.shape[1]] / self.record.span
            self._end_correction = (
                self.closing.inner @ jumps + self._ramp_motion - self.slope * slopes,
                slopes,
            )

    @property
    def inner_motion(self) -> tuple[Any, ...]:
        """The inner motion with what is known of it, to return to (``return_to``)."""
        return self.feedback, self.jumps, self._end_correction, self._waves, self._laws

    def return_to(self, inner_motion: tuple[Any, ...]) -> None:
        """Sets an inner motion that the view had, with what was known of it."""
        self.feedback, self.jumps, self._end_correction, self._waves, self._laws = inner_motion

    @cached_property
    def slope(self) -> Complex128:
        """(F, 1) lines of a straight line that rises by one a second."""
        out: Complex128 = (2j / np.where(self.omega > 0, self.omega, np.inf))[:, None]
        return out

    @cached_property
    def _ramp_motion(self) -> Complex128:
        """(F, ΣN) motion that belongs to the straight line between the motors' ends."""
        out: Complex128 = np.einsum("fqm,fm->fq", self.motion, self.slope * self.record.ramp)
        return out

    def missing_with(self, extra: Complex128) -> Complex128 | None:
        """(F, M) missing torque with ``extra`` (F, M) of effects; ``None`` where it is not known."""
        if self.closing is not None:
            return self.closing.missing_with(extra)
        return None if self.missing is None else self.missing + extra

    def closing_jumps(self, extra: Complex128) -> Float64:
        """(2ΣN,) jumps with ``extra`` (F, M) contributed by effects; empty where the record closes."""
        return np.zeros(0) if self.closing is None else self.closing.jumps(extra)

    def spectrum(self, pattern: Pattern) -> Complex128:
        """(F,) motion along the pattern."""
        return along(pattern, self.base) + along(pattern, self.feedback)

    def wave(self, pattern: Pattern) -> Float64:
        """(n,) motion along the pattern over time."""
        return self._wave_with_hidden(pattern, False)

    def velocity(self, pattern: Pattern) -> Float64:
        """(n,) velocity along the pattern over time."""
        return self._wave_with_hidden(pattern, True)

    def set_hidden_motion(self, pattern: Pattern, lines: Complex128 | None) -> None:
        """Sets motion (n//2 + 1,) on the waves' own lines that is added along the pattern; ``None`` removes
        it."""
        self._laws = {}
        if lines is None:
            self._hidden_motion.pop(pattern, None)
        else:
            self._hidden_motion[pattern] = lines

    def _wave_with_hidden(self, pattern: Pattern, rate: bool) -> Float64:
        out, lines = self._wave(pattern, rate), self._hidden_motion.get(pattern)
        if lines is None:
            return out
        more: Float64 = np.fft.irfft(1j * self.record.wave_omega * lines if rate else lines, out.size)
        return out + more

    def _wave(self, pattern: Pattern, rate: bool) -> Float64:
        key = (pattern, rate)
        if key in self._waves:
            return self._waves[key]
        record = self.record
        if self.is_measured(pattern):
            i = self.structure.motor_dofs.index(pattern[0][0])
            out: Float64 = (record.motor_velocity if rate else record.motor_wave)[:, i] * pattern[0][1]
        else:
            x = self.spectrum(pattern)
            if self._end_correction is not None:
                x = x + along(pattern, self._end_correction[0])
                wander = sum(sign * self._end_correction[1][at] for at, sign in pattern)
            else:
                wander = sum(sign * record.ramp[self._axis_of(at)] for at, sign in pattern)
            out = record.to_wave(1j * self.omega * x if rate else x)
            if wander:
                out = out + (wander if rate else wander * record.wave_time)
        self._waves[key] = out
        return out

    def _axis_of(self, coordinate: int) -> int:
        return int(np.searchsorted(np.asarray(self.structure.motor_dofs), coordinate, side="right") - 1)

    def to_lines(self, basis: Float64, *, smeared: bool = False) -> Complex128:
        """(F, L) amplitudes of (n, L) waves; ``smeared``: they are means over a triangle of two samples."""
        record, count = self.record, basis.shape[0]
        out: Complex128 = np.fft.rfft(basis, axis=0)[record.lines] * (2.0 / count)
        if record.transient:
            out = out + (basis[-1] - basis[0]) / count
        out[0] *= 0.5
        if smeared:
            out = out / self.averaging_gain[:, None]
        return out

    def drive_means(self, axis: int) -> Float64:
        """(n, k) mean torque of a drive over the k parts of the interval after each sample of the waves.

        Held over its samples, from ``late`` on.
        """
        return self.cached(("drive", axis), lambda: self._drive_means(axis))

    def _drive_means(self, axis: int) -> Float64:
        record, late = self.record, float(self.late[axis])
        parts = max(round(record.wave_step / record.step), 2)
        pad = int(abs(late) / record.step) + 2
        torque = np.pad(record.torque_wave[:, axis], pad, "edge" if record.transient else "wrap")
        reached = np.concatenate(([0.0], np.cumsum(torque) * record.step))
        edges = np.arange(record.samples * parts + 1) * (record.wave_step / parts) - late
        whole = np.interp(edges + pad * record.step, np.arange(reached.size) * record.step, reached)
        out: Float64 = np.diff(whole).reshape(record.samples, parts) * (parts / record.wave_step)
        return out

    def condensed_force(self, pattern: Pattern) -> Complex128:
        """(F, M) Wᵀ b: torques at the motors that equal a unit force along the pattern."""
        if pattern not in self._condensed_forces:
            self._condensed_forces[pattern] = sum(
                (sign * self.motion[:, at] for at, sign in pattern[1:]),
                start=pattern[0][1] * self.motion[:, pattern[0][0]],
            )
        return self._condensed_forces[pattern]

    def inner_receptance(self, pattern: Pattern) -> Complex128:
        """(F, ΣN) Z_ii⁻¹ b: motion of the inner coordinates under a unit force along the pattern, motors
        held."""
        if pattern not in self._inner_receptances:
            self._inner_receptances[pattern] = sum(
                (sign * self.inner[:, :, at] for at, sign in pattern[1:]),
                start=pattern[0][1] * self.inner[:, :, pattern[0][0]],
            )
        return self._inner_receptances[pattern]

    def distributed_force(self, pattern: Pattern, missing: Complex128) -> Complex128:
        """(F,) least-squares force along the pattern for ``missing`` (F, M), each line weighted by its
        information.

        For sums over many lines: of a force spread over all of them, none need stand out of its noise.
        """
        reached = self.condensed_force(pattern)
        weighted = np.einsum("fij,fj->fi", self.certainty, reached).conj()
        information = np.einsum("fi,fi->f", weighted, reached).real
        most = max(float(np.median(information)), 1e-300)
        force: Complex128 = -np.einsum("fi,fi->f", weighted, missing) / np.maximum(information, most)
        return force

    def estimated_force(self, pattern: Pattern, missing: Complex128) -> Complex128:
        """(F,) force along the pattern that explains ``missing`` (F, M), whatever its law.

        r = −Wᵀ b f is solved for f with the weights of the noise, shrunk by its own noise (Wiener) and zero
        where noise alone could be all of it (statistical: once in 400 records on any of their lines).

        The motors hardly feel a force on inner masses far below their resonance; there a small error of the
        linear parameters looks like a huge force, which would move the inner masses by more than they move.
        So on the half of the lines where it is felt least the force is limited to the largest on the others.
        """
        reached = self.condensed_force(pattern)
        weighted = np.einsum("fij,fj->fi", self.certainty, reached).conj()
        information = np.einsum("fi,fi->f", weighted, reached).real
        safe = np.maximum(information, 1e-300)
        force = -np.einsum("fi,fi->f", weighted, missing) / safe
        power = np.abs(force) ** 2 * safe
        # A pair of forces moves nothing at 0 Hz; its condensed force there is rounding.
        is_felt = np.abs(reached).max(axis=1) > 1e-10
        beyond = power > 6.0 + np.log(max(self.omega.size, 1))
        keep = np.where(is_felt & beyond, 1.0 - 1.0 / np.maximum(power, 1e-300), 0.0)
        out: Complex128 = keep * force
        if is_felt.any():
            is_well_felt = is_felt & (information >= np.median(information[is_felt]))
            most, size = float(np.abs(out[is_well_felt]).max()), np.abs(out)
            out = np.where(is_well_felt | (size <= most), out, out * (most / np.maximum(size, 1e-300)))
        return out

    def correction(
        self, patterns: tuple[Pattern, ...], remainder: Complex128, outside: Complex128
    ) -> Complex128:
        """(F, ΣN) inner motion due to forces that the laws lack: their mean given ``remainder``.

        ``remainder`` (F, M) is the missing torque with the laws' contributions. A law of the wrong size
        reconstructs the wrong inner motion, which near a clamped resonance feeds back and diverges; the
        measured torque tells the true force. Prior variance of the forces: the force that explains all
        missing torque at each place alone, so that nothing is corrected where there is only noise. It is
        taken without ``outside`` (F, M), the contributions of drives and sensors: a late torque is no force
        at any mass, and as a prior it would let all noise pass.
        """
        if patterns not in self._gains:
            missing = self.missing_with(outside)
            if missing is None:
                return np.zeros_like(self.base)
            pushes = np.stack([self.condensed_force(p) for p in patterns], axis=-1)  # (F, M, T)
            prior = np.stack([np.abs(self.estimated_force(p, missing)) ** 2 for p in patterns], axis=-1)
            weighted = np.einsum("fmt,fmn->ftn", pushes.conj(), self.certainty)
            inner = np.einsum("ftn,fnu->ftu", weighted, pushes) * prior[:, None, :]
            inner = inner + np.eye(len(patterns))
            # S Hᴴ(H S Hᴴ + C)⁻¹ = S (Hᴴ C⁻¹ H S + 1)⁻¹ Hᴴ C⁻¹
            self._gains[patterns] = -prior[..., None] * np.linalg.solve(inner, weighted)
        forces = np.einsum("ftm,fm->ft", self._gains[patterns], remainder)
        out: Complex128 = np.zeros_like(self.base)
        for k, pattern in enumerate(patterns):
            out = out - self.inner_receptance(pattern) * forces[:, k, None]
        return out

    def correction_gain(self, patterns: tuple[Pattern, ...]) -> Complex128 | None:
        """(F, T, M) gain from the remainder to forces along the patterns in ``correction``; ``None`` before
        its first call."""
        return self._gains.get(patterns)

    def driving_point_receptance(self, pattern: Pattern) -> Complex128:
        """(F,) bᵀ Z_ii⁻¹ b: motion along the pattern under a unit force along it, motors held."""
        return along(pattern, self.inner_receptance(pattern))


def along(pattern: Pattern, motion: Complex128) -> Complex128:
    """(F, ...) component along the pattern of the motion (F, ΣN, ...) of all coordinates."""
    (first, sign), *others = pattern
    total: Complex128 = sign * motion[:, first]
    for at, sign in others:
        total += sign * motion[:, at]
    return total


def rms(values: Sequence[Float64]) -> float:
    """Largest standard deviation of several waves."""
    return max((float(np.std(v)) for v in values), default=0.0)
