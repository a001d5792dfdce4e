"""A spring with free play, its force read from the measured torque: the law holds to within a share of it.

Given the motors' motion alone, a load behind a wide gap may move in many ways: it rattles, and the least
error of a parameter is another motion. Whoever asks for a motion that follows the law exactly finds one of
those, not the one that was measured, and a fit has a valley for each. The torque says which it was: what the
motor does not take for its own mass goes through the spring. So here the force f beside the linear spring is
unknown on every line and in every record, as are the ends of records that do not close, and two things are
asked of it,

    r + W·f = 0 to within the noise,        f = law(deflection under f) to within a share of the torque,

least squares over both. The share is lowered step by step, the noise of the torque with it; the unknowns of
each record are eliminated record by record (weak-constraint assimilation).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from invid.effects.motion import View, along
from invid.model.place import Pattern
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.whitening import whitener

STAGES = (0.1, 0.03, 0.01, 0.003)
"""Shares of the torque to which the law is asked to hold, one after the other."""
PASSES = 8
"""Steps at most for each of them; the law has corners, and more find no better place."""
ENOUGH = 1e-3
"""Share of the cost that a further step has to gain."""
NOISIER = 0.1
"""Share of the law's own looseness that counts as noise of the torque besides the sensors'."""


@dataclass(frozen=True)
class Gap:
    """A spring, its damper, and the width of the gap in series with both."""

    stiffness: float
    damper: float
    width: float


class Reading:
    """The force along one spring of a record at one plant, beside the linear spring that is in that plant.

    ``linear`` (F, M): missing torque of the plant alone. ``share``: of the torque, to which the law holds.
    The unknowns are a vector: real parts of the force on all lines, imaginary ones but at 0 Hz, then the ends
    (in units of twice the motion) where the record does not close.
    """

    def __init__(
        self, view: View, pattern: Pattern, linear: Complex128, covariance: Complex128, share: float
    ) -> None:
        self.view, self.pattern = view, pattern
        record = view.record
        motors = linear.shape[1]
        level = float(np.sqrt(np.mean(np.abs(view.acting[1:]) ** 2, axis=0)).max())
        self.level = share * level
        index = np.arange(motors)
        noisy = covariance.copy()
        noisy[:, index, index] += (NOISIER * self.level) ** 2
        root = whitener(noisy)
        if record.weight.size:
            root = root * record.weight[:, None, None]
        self.moved = -view.yields(pattern)
        self.across = along(pattern, self.moved)
        self.white = np.einsum("fij,fj->fi", root, linear)
        self.felt = np.einsum("fij,fj->fi", root, view.push(pattern))
        self.scale, self.ends = np.zeros(0), np.zeros((*linear.shape, 0), dtype=complex)
        if view.closing is not None:
            self.scale = view.farthest
            self.ends = np.einsum("fij,fjk->fik", root, view.closing.torque * self.scale)

    @property
    def count(self) -> int:
        """Unknowns."""
        return 2 * self.view.omega.size - 1 + self.scale.size

    def unpacked(self, u: Float64) -> tuple[Complex128, Float64]:
        """(F,) force and ends out of the vector of unknowns."""
        lines = self.view.omega.size
        force = u[:lines].astype(complex)
        force[1:] += 1j * u[lines : 2 * lines - 1]
        return force, u[2 * lines - 1 :]

    def deflection(self, u: Float64) -> Float64:
        """(n,) over time; leaves the view in that motion."""
        force, ends = self.unpacked(u)
        jumps = ends * self.scale if self.view.closing is not None else None
        self.view.respond(self.moved * force[:, None], jumps)
        return self.view.wave(self.pattern)

    def residual(self, u: Float64, gap: Gap) -> tuple[Float64, Float64]:
        """(rows,) what is asked of the unknowns, and the deflection (n,)."""
        force, ends = self.unpacked(u)
        torque = self.white + self.felt * force[:, None] + self.ends @ ends
        wave = self.deflection(u)
        law = (force - law_of(self.view, wave, gap)) / self.level
        rows = (torque.real.ravel(), torque.imag.ravel(), law.real, law.imag[1:], ends)
        return np.concatenate(rows), wave

    @cached_property
    def _normal(self) -> Float64:
        """(n, n) normal matrix of what the torque says, the same for every law."""
        lines, count = self.view.omega.size, self.count
        out = np.zeros((count, count))
        own = (np.abs(self.felt) ** 2).sum(axis=1)
        out[np.arange(2 * lines - 1), np.arange(2 * lines - 1)] = np.concatenate((own, own[1:]))
        if self.scale.size:
            at = 2 * lines - 1
            cross = np.einsum("fi,fik->fk", self.felt.conj(), self.ends)
            out[:at, at:] = np.concatenate((cross.real, cross.imag[1:]))
            out[at:, :at] = out[:at, at:].T
            flat = self.ends.reshape(-1, self.scale.size)
            out[at:, at:] = (flat.conj().T @ flat).real + np.eye(self.scale.size)
        return out

    def _law_rows(self, wave: Float64, gap: Gap) -> Float64:
        """(2F − 1, n) derivative of the law's rows by the unknowns, at a deflection (n,)."""
        view, record = self.view, self.view.record
        lines, samples = view.omega.size, wave.size
        # What is within the gap is a wave times ones and zeros: a convolution of lines.
        inside = (np.abs(wave) < 0.5 * gap.width).astype(np.float64)
        spread = np.fft.fft(inside) / samples
        at = record.lines
        below, above = spread[(at[:, None] - at) % samples], spread[(at[:, None] + at) % samples]
        even, odd = below + above, 1j * (below - above)
        even[:, 0], odd[:, 0] = 2.0 * spread[at % samples], 0.0
        even[0] *= 0.5
        odd[0] *= 0.5
        resists = (gap.stiffness + 1j * view.omega * gap.damper) / view.smear
        even, odd = even * resists[:, None], odd * resists[:, None]
        rows = np.zeros((lines, self.count), dtype=complex)
        rows[:, :lines] = even * self.across.real + odd * self.across.imag
        rows[:, lines : 2 * lines - 1] = (odd * self.across.real - even * self.across.imag)[:, 1:]
        index = np.arange(lines)
        rows[index, index] += 1.0
        rows[index[1:], lines - 1 + index[1:]] += 1j
        if self.scale.size:
            rows[:, 2 * lines - 1 :] = self._ends_in_law(inside, gap)
        rows /= self.level
        return np.concatenate((rows.real, rows.imag[1:]))

    def _ends_in_law(self, inside: Float64, gap: Gap) -> Complex128:
        """(F, ends) what the law's rows change by with each end; the motion is linear in them."""
        view, lines = self.view, self.view.omega.size
        kept, jumps = view.feedback, view.jumps
        nothing = self.deflection(np.zeros(self.count))
        out = np.zeros((lines, self.scale.size), dtype=complex)
        for k in range(self.scale.size):
            one = np.zeros(self.count)
            one[2 * lines - 1 + k] = 1.0
            out[:, k] = -resistance(view, inside * (self.deflection(one) - nothing), gap)
        view.respond(kept, jumps)
        return out

    def linearised(self, wave: Float64, gap: Gap) -> tuple[Float64, tuple[Float64, bool]]:
        """The law's rows, and the factored normal matrix of all rows."""
        rows = self._law_rows(wave, gap)
        normal = self._normal + rows.T @ rows
        diagonal = np.diag_indices_from(normal)
        normal[diagonal] += 1e-12 * normal[diagonal] + 1e-14 * float(normal[diagonal].max())
        return rows, cho_factor(normal, check_finite=False)

    def gathered(self, columns: Float64, rows: Float64) -> Float64:
        """(n, k) transposed Jacobian times (rows, k), the Jacobian's law part being ``rows``."""
        size = self.felt.size
        real, imag = columns[:size], columns[size : 2 * size]
        both = (real + 1j * imag).reshape(*self.felt.shape, -1)
        law = 2 * size + rows.shape[0]
        out = rows.T @ columns[2 * size : law]
        at = 2 * self.view.omega.size - 1
        along_force = np.einsum("fi,fik->fk", self.felt.conj(), both)
        out[:at] += np.concatenate((along_force.real, along_force.imag[1:]))
        if self.scale.size:
            flat = self.ends.reshape(size, -1)
            out[at:] += (flat.conj().T @ both.reshape(size, -1)).real + columns[law:]
        return out

    def solved(self, u: Float64, gap: Gap, passes: int = PASSES) -> Float64:
        """(n,) the unknowns that fit best, from ``u``; leaves the view there."""
        residual, wave = self.residual(u, gap)
        cost = float(residual @ residual)
        for _ in range(passes):
            rows, factor = self.linearised(wave, gap)
            step = -cho_solve(factor, self.gathered(residual[:, None], rows)[:, 0], check_finite=False)
            for part in (1.0, 0.5, 0.2, 0.05):
                there, moved = self.residual(u + part * step, gap)
                if float(there @ there) < cost:
                    break
            else:
                break
            gained, cost = cost - float(there @ there), float(there @ there)
            u, residual, wave = u + part * step, there, moved
            if gained < ENOUGH * cost:
                break
        self.deflection(u)
        return u


def law_of(view: View, wave: Float64, gap: Gap) -> Complex128:
    """(F,) force beside the linear spring and damper at a deflection (n,): both lose what is in the gap."""
    return resistance(view, np.clip(wave, -0.5 * gap.width, 0.5 * gap.width), gap)


def resistance(view: View, inside: Float64, gap: Gap) -> Complex128:
    """(F,) what spring and damper lose of a wave (n,) that they do not feel."""
    lines = view.to_lines(inside[:, None], smeared=True)[:, 0]
    rate = 1j * view.omega * lines
    if view.record.transient:
        rate = rate + (inside[-1] - inside[0]) * 2.0 / view.record.span
        rate[0] *= 0.5
    out: Complex128 = -gap.stiffness * lines - gap.damper * rate
    return out


def read(view: View, pattern: Pattern, gap: Gap, start: Float64 | None = None) -> tuple[Complex128, Float64]:
    """(F,) force of the law in the motion that the measured torque tells, and the unknowns.

    The view is left in that motion. ``start``: the unknowns of a plant close by, where only the last stage is
    needed."""
    linear = view.missing if view.closing is None else view.closing.linear
    if linear is None:
        raise ValueError("nothing is known of the missing torque")
    covariance: Complex128 = np.asarray(np.linalg.inv(view.certainty), dtype=np.complex128)
    u = start
    for share in STAGES if start is None else STAGES[-1:]:
        reading = Reading(view, pattern, linear, covariance, share)
        u = reading.solved(np.zeros(reading.count) if u is None else u, gap)
    return law_of(view, view.wave(pattern), gap), np.asarray(u)


__all__ = ["STAGES", "Gap", "Reading", "law_of", "read", "resistance"]
