"""One record, seen through one linear plant."""

from __future__ import annotations

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
KEPT = 32
"""Laws of measured motion that a record keeps: more than act at once, and few beside its spectra."""


@dataclass(frozen=True, eq=False)
class Closing:
    """How the ends of a record that does not close follow from what is missing."""

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
        """(2ΣN,) largest line of motion for a unit jump: jumps in the units of motion."""
        out: Float64 = np.abs(self.inner).max(axis=(0, 1)) + 1e-300
        return out

    def follow(self, missing: Complex128) -> Float64:
        """(2ΣN, P) jumps that go with (F, M, P) of missing torque."""
        out: Float64 = np.tensordot(self.gain, missing, axes=((1, 2), (0, 1))).real
        return out

    def left(self, extra: Complex128) -> Complex128:
        """(F, M) missing torque with ``extra`` (F, M) of effects, without what the ends explain."""
        out: Complex128 = self.linear + extra + self.torque @ self.jumps(extra)
        return out

    def jumps(self, extra: Complex128) -> Float64:
        """(2ΣN,) with ``extra`` (F, M) contributed by effects."""
        out: Float64 = np.einsum("jfm,fm->j", self.gain, self.linear + extra).real
        return out


class MotorLaw(Protocol):
    """A law of the motion of one motor, with its size."""

    @property
    def axis(self) -> int:
        """Of the motor."""
        ...

    def over_time(self, view: View) -> Float64:
        """(n,) resistance [N·m or N]."""
        ...


class View:
    """One record seen through one linear plant; time-domain waves are made once."""

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
        self.late = late
        """(M,) how much later than its samples the held torque of each axis steps [s]."""
        self.inertance = inertance
        """(M, M) acceleration of the motors over their torque, far above all modes."""
        self.base = np.einsum("fqm,fm->fq", motion, record.filtered)
        self.feedback: Complex128 = np.zeros_like(self.base)
        self.of_ends: Complex128 = np.zeros_like(self.base)
        """(F, ΣN) motion besides ``base`` that the ends of a record that does not close stand for."""
        self._open: tuple[Complex128, Float64] | None = None
        """Where a record does not close: what the waves of inner motion have besides ``base`` (F, ΣN), and
        each coordinate's mean rate (ΣN,)."""
        self.jumps: Float64 = np.zeros(0)
        """(2ΣN,) positions, then velocities: how far the ends of a record that does not close are apart."""
        self.closing: Closing | None = None
        self.secants = Secants()
        self.starts: dict[Pattern, float] = {}
        """Where sliders stood when the record began, over what they give way at."""
        self.missing: Complex128 | None = None
        """(F, M) missing torque of the linear model; None where forces cannot be read from it."""
        self.certainty: Complex128 = np.zeros((0, 0, 0), dtype=complex)
        """(F, M, M) inverse covariance of ``missing`` and of ``remaining``."""
        self.remaining: Complex128 | None = None
        """(F, M) missing torque that the causes chosen so far and the record's ends leave."""
        self.beside: tuple[MotorLaw, ...] = ()
        """Laws at motors other than dry friction, which feels what they take."""
        self._waves: dict[tuple[Pattern, bool], Float64] = {}
        self._gains: dict[tuple[Pattern, ...], Complex128] = {}
        self._hidden: dict[Pattern, Complex128] = {}
        self._pushes: dict[Pattern, Complex128] = {}
        self._yields: dict[Pattern, Complex128] = {}
        self._measured: dict[Hashable, Any] = {}

    def measured(self, key: Hashable, make: Callable[[], T]) -> T:
        """What ``make`` gives once, kept: for what follows from the motors' measured motion, which settling
        inner motion does not change."""
        out: T = self._measured.pop(key) if key in self._measured else make()
        self._measured[key] = out
        if len(self._measured) > KEPT:
            del self._measured[next(iter(self._measured))]
        return out

    def forget_measured(self) -> None:
        """Has that made anew: it may hold a little of the inner motion there was."""
        self._measured.clear()

    def is_measured(self, pattern: Pattern) -> bool:
        """Whether the motion along a pattern is that of one motor."""
        return len(pattern) == 1 and pattern[0][0] in self.structure.motor_dofs

    @property
    def omega(self) -> Float64:
        """(F,) [rad/s]."""
        return self.record.omega

    @cached_property
    def raw(self) -> Complex128:
        """(F, ΣN) motion of the linear plant at the motors' positions as they were measured."""
        out: Complex128 = np.einsum("fqm,fm->fq", self.motion, self.record.position)
        return out

    @cached_property
    def farthest(self) -> Float64:
        """(2ΣN,) twice the motion and its rate: what the ends of the record are apart by at most."""
        size = np.sqrt((np.abs(self.base) ** 2).sum(axis=0))
        rate = np.sqrt((np.abs(self.omega[:, None] * self.base) ** 2).sum(axis=0))
        out: Float64 = 2.0 * np.concatenate((size, rate)) + 1e-300
        return out

    @cached_property
    def smear(self) -> Float64:
        """(F,) what the mean over a triangle of two samples takes of a wave."""
        out: Float64 = np.sinc(self.omega * self.record.wave_step / 2 / np.pi) ** 2
        return out

    def respond(self, feedback: Complex128, jumps: Float64 | None = None) -> None:
        """Sets what all effects do to the inner coordinates, (F, ΣN), and what the ends of a record that does
        not close are apart by, where given.

        The motors' own wander is in their waves.
        """
        self.feedback = feedback
        self._waves = {k: v for k, v in self._waves.items() if self.is_measured(k[0])}
        if self.closing is not None and jumps is not None:
            self.jumps = jumps
            slopes = jumps[: self.base.shape[1]] / self.record.span
            self._open = (self.closing.inner @ jumps + self._wander - self.slope * slopes, slopes)

    @cached_property
    def slope(self) -> Complex128:
        """(F, 1) lines of a straight line that rises by one a second."""
        out: Complex128 = (2j / np.where(self.omega > 0, self.omega, np.inf))[:, None]
        return out

    @cached_property
    def _wander(self) -> Complex128:
        """(F, ΣN) motion that goes with the straight line between the motors' ends."""
        out: Complex128 = np.einsum("fqm,fm->fq", self.motion, self.slope * self.record.ramp)
        return out

    def left(self, extra: Complex128) -> Complex128 | None:
        """(F, M) missing torque with ``extra`` (F, M) of effects; ``None`` where it is not known."""
        if self.closing is not None:
            return self.closing.left(extra)
        return None if self.missing is None else self.missing + extra

    def closed(self, extra: Complex128) -> Float64:
        """(2ΣN,) jumps that go with what effects contribute (F, M); none where the record closes."""
        return np.zeros(0) if self.closing is None else self.closing.jumps(extra)

    def spectrum(self, pattern: Pattern) -> Complex128:
        """(F,) motion along the pattern."""
        return along(pattern, self.base) + along(pattern, self.feedback)

    def wave(self, pattern: Pattern) -> Float64:
        """(n,) motion along the pattern over time."""
        return self._with_hidden(pattern, False)

    def velocity(self, pattern: Pattern) -> Float64:
        """(n,) its derivative."""
        return self._with_hidden(pattern, True)

    def hide(self, pattern: Pattern, lines: Complex128 | None) -> None:
        """Adds (n//2 + 1,) of the waves' own lines to the motion along the pattern, instead of what was added
        before; None for none."""
        if lines is None:
            self._hidden.pop(pattern, None)
        else:
            self._hidden[pattern] = lines

    def _with_hidden(self, pattern: Pattern, rate: bool) -> Float64:
        out, lines = self._wave(pattern, rate), self._hidden.get(pattern)
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
            wander = sum(sign * record.ramp[self._axis(at)] for at, sign in pattern)
            if self._open is not None:
                x = x + along(pattern, self._open[0])
                wander = sum(sign * self._open[1][at] for at, sign in pattern)
            out = record.to_wave(1j * self.omega * x if rate else x)
            if wander:
                out = out + (wander if rate else wander * record.wave_time)
        self._waves[key] = out
        return out

    def _axis(self, coordinate: int) -> int:
        return int(np.searchsorted(np.asarray(self.structure.motor_dofs), coordinate, side="right") - 1)

    def to_lines(self, basis: Float64, *, smeared: bool = False) -> Complex128:
        """(F, L) amplitudes of (n, L) waves; ``smeared``: they are means over a triangle of two samples."""
        record, count = self.record, basis.shape[0]
        out: Complex128 = np.fft.rfft(basis, axis=0)[record.lines] * (2.0 / count)
        if record.transient:
            out = out + (basis[-1] - basis[0]) / count
        out[0] *= 0.5
        if smeared:
            out = out / self.smear[:, None]
        return out

    def drive_means(self, axis: int) -> Float64:
        """(n, k) mean torque of a drive over the k parts of the interval after each sample of the waves.

        Held over its samples, from ``late`` on.
        """
        return self.measured(("drive", axis), lambda: self._drive_means(axis))

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

    def push(self, pattern: Pattern) -> Complex128:
        """(F, M) Wᵀ b: how a force along the pattern reaches the motors."""
        if pattern not in self._pushes:
            self._pushes[pattern] = sum(
                (sign * self.motion[:, at] for at, sign in pattern[1:]),
                start=pattern[0][1] * self.motion[:, pattern[0][0]],
            )
        return self._pushes[pattern]

    def yields(self, pattern: Pattern) -> Complex128:
        """(F, ΣN) Z_ii⁻¹ b: how the inner coordinates give way."""
        if pattern not in self._yields:
            self._yields[pattern] = sum(
                (sign * self.inner[:, :, at] for at, sign in pattern[1:]),
                start=pattern[0][1] * self.inner[:, :, pattern[0][0]],
            )
        return self._yields[pattern]

    def spread(self, pattern: Pattern, missing: Complex128) -> Complex128:
        """(F,) force along the pattern that ``missing`` (F, M) would take, each line by how well it is told.

        For what is summed up over many lines: of a force that is spread over all of them none need stand out
        of its noise.
        """
        push = self.push(pattern)
        weighted = np.einsum("fij,fj->fi", self.certainty, push).conj()
        information = np.einsum("fi,fi->f", weighted, push).real
        most = max(float(np.median(information)), 1e-300)
        force: Complex128 = -np.einsum("fi,fi->f", weighted, missing) / np.maximum(information, most)
        return force

    def inferred(self, pattern: Pattern, missing: Complex128) -> Complex128:
        """(F,) force along the pattern that ``missing`` (F, M) would take, whatever its law.

        r = −Wᵀ b f solved for f with the weights of the noise, shrunk by its own noise (Wiener) and zero
        where noise alone could be all of it (once in 400 records on any of their lines).

        The motors hardly feel a force on inner masses far below their resonance; there the least error of the
        linear parameters reads as a huge one, which would move the inner masses by more than they move. So
        on the half of the lines where it is felt least the force is no larger than the largest on the others.
        """
        push = self.push(pattern)
        weighted = np.einsum("fij,fj->fi", self.certainty, push).conj()
        information = np.einsum("fi,fi->f", weighted, push).real
        safe = np.maximum(information, 1e-300)
        force = -np.einsum("fi,fi->f", weighted, missing) / safe
        power = np.abs(force) ** 2 * safe
        # A pair of forces moves nothing at 0 Hz: what is left of its push there is rounding.
        felt = np.abs(push).max(axis=1) > 1e-10
        beyond = power > 6.0 + np.log(max(self.omega.size, 1))
        keep = np.where(felt & beyond, 1.0 - 1.0 / np.maximum(power, 1e-300), 0.0)
        out: Complex128 = keep * force
        if felt.any():
            well = felt & (information >= np.median(information[felt]))
            most, size = float(np.abs(out[well]).max()), np.abs(out)
            out = np.where(well | (size <= most), out, out * (most / np.maximum(size, 1e-300)))
        return out

    def correction(self, patterns: tuple[Pattern, ...], rest: Complex128, outside: Complex128) -> Complex128:
        """(F, ΣN) what forces beyond the laws do to inner coordinates: the mean of what ``rest`` leaves open.

        ``rest`` is the missing torque with the laws' contributions. A law at the wrong size reconstructs
        the wrong inner motion, which near a clamped resonance feeds back and runs away; the measured
        torque says what force there really was. Prior variance of the forces: what is missing would take at
        each place alone, so that nothing is corrected where noise is all there is; without what ``outside``
        (F, M) of drives and sensors explains: a late torque is no force at any mass, and as a prior it lets
        all noise through.
        """
        if patterns not in self._gains:
            asking = self.left(outside)
            if asking is None:
                return np.zeros_like(self.base)
            pushes = np.stack([self.push(p) for p in patterns], axis=-1)  # (F, M, T)
            prior = np.stack([np.abs(self.inferred(p, asking)) ** 2 for p in patterns], axis=-1)
            weighted = np.einsum("fmt,fmn->ftn", pushes.conj(), self.certainty)
            inner = np.einsum("ftn,fnu->ftu", weighted, pushes) * prior[:, None, :]
            inner = inner + np.eye(len(patterns))
            # S Hᴴ(H S Hᴴ + C)⁻¹ = S (Hᴴ C⁻¹ H S + 1)⁻¹ Hᴴ C⁻¹
            self._gains[patterns] = -prior[..., None] * np.linalg.solve(inner, weighted)
        forces = np.einsum("ftm,fm->ft", self._gains[patterns], rest)
        out: Complex128 = np.zeros_like(self.base)
        for k, pattern in enumerate(patterns):
            out = out - self.yields(pattern) * forces[:, k, None]
        return out

    def correction_gain(self, patterns: tuple[Pattern, ...]) -> Complex128 | None:
        """(F, T, M) forces along the patterns over what is left, as ``correction`` has found them; ``None``
        where it was never asked."""
        return self._gains.get(patterns)

    def compliance(self, pattern: Pattern) -> Complex128:
        """(F,) bᵀ Z_ii⁻¹ b."""
        return along(pattern, self.yields(pattern))


def along(pattern: Pattern, motion: Complex128) -> Complex128:
    """(F, ...) of the (F, ΣN, ...) motion of every coordinate that along the pattern."""
    (first, sign), *others = pattern
    total: Complex128 = sign * motion[:, first]
    for at, sign in others:
        total += sign * motion[:, at]
    return total


def rms(values: Sequence[Float64]) -> float:
    """Largest rms of several waves, their means taken out."""
    return max((float(np.std(v)) for v in values), default=0.0)
