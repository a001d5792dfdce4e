"""What effects are evaluated on: the motion of every coordinate in every record, over time and on lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.arrays import Complex128, Float64, Int64
from invid.refine.problem import Block, State
from invid.refine.structure import ChainStructure
from invid.spectra import LineSpectra

OVERSAMPLE = 12
"""Points of the evaluation grid per period of the highest line, so that the harmonics of a force law
up to the tenth do not alias into the band."""


@dataclass(frozen=True, eq=False)
class RecordMotion:
    """Motion in one record, on n uniform points over one period (or the whole record).

    Attributes
    ----------
    index
        (F,) DFT index of each line of the block.
    motion, stiffness
        (F, ΣN, M) W and (F, M, M) Z.
    q
        (F, ΣN) motion of all coordinates on the lines.
    position, velocity, torque
        (n, ΣN), (n, ΣN), (n, M).
    periodic
        False for a record taken whole, which does not close.
    start_s, end_s
        When the record ran, on the recording's own clock.
    """

    block: Block
    axis_noise: Float64
    index: Int64
    motion: Complex128
    stiffness: Complex128
    q: Complex128
    position: Float64
    velocity: Float64
    torque: Float64
    periodic: bool
    start_s: float
    end_s: float

    def lines(self, wave: Float64) -> Complex128:
        """(F,) amplitudes on the lines of a waveform (n,); line 0 scaled to the variance of the others."""
        spectrum: Complex128 = np.fft.rfft(wave)[self.index] * (2.0 / wave.shape[0])
        if self.index[0] == 0:
            spectrum[0] /= np.sqrt(2.0)
        return spectrum

    def seen(self, force: Complex128, a: int, b: int | None = None) -> Complex128:
        """(F, M) missing torque of a resisting force (F,) on coordinate a, or between a and b."""
        w = self.motion[:, a, :]
        if b is not None:
            w = w - self.motion[:, b, :]
        result: Complex128 = w * force[:, None]
        return result

    def deflection(self, a: int, b: int) -> Float64:
        """(n,) position of a relative to b."""
        result: Float64 = self.position[:, a] - self.position[:, b]
        return result

    def velocity_noise(self, axis: int) -> float:
        """Standard deviation of the motor velocity's noise on the evaluation grid."""
        return float(np.sqrt((self.block.omega**2).sum() * self.axis_noise[axis] / 2))


@dataclass(frozen=True, eq=False)
class Context:
    """All records at one parameter vector, and the springs (in the order of ``spring_pairs``)."""

    structure: ChainStructure
    records: tuple[RecordMotion, ...]
    springs: Float64

    def velocity_rms(self, a: int) -> float:
        """Largest rms velocity of a coordinate over the records."""
        return max(float(np.sqrt(np.mean(r.velocity[:, a] ** 2))) for r in self.records)

    def span(self, a: int, b: int | None = None) -> float:
        """Largest peak-to-peak motion of a coordinate, or of a pair's deflection."""
        spans = [np.ptp(r.position[:, a] if b is None else r.deflection(a, b)) for r in self.records]
        return max(float(max(spans)), 1e-15)

    @property
    def top(self) -> float:
        """Highest line [rad/s]."""
        return max(float(r.block.omega[-1]) for r in self.records)


def context_of(
    structure: ChainStructure,
    p: Float64,
    states: Sequence[State],
    spectra: Sequence[LineSpectra],
    spans: Sequence[tuple[float, float]],
    forces: Sequence[Complex128] | None = None,
    place: tuple[int, int | None] | None = None,
) -> Context:
    """Motion in every record.

    ``forces``: per record (F, ΣN) known resisting forces on all coordinates; inner coordinates give
    way to them. ``place``: a coordinate or pair whose force is not known: there the force that the
    missing torque itself asks for is used (a Wiener estimate, line by line).
    """
    values = structure.physical(p[: structure.count])
    records = []
    for number, (state, s, span) in enumerate(zip(states, spectra, spans, strict=True)):
        q = state.all_motion
        if forces is not None:
            q = q - np.einsum("fab,fb->fa", state.inner, forces[number])
        if place is not None:
            q = q + _inferred(state, place)
        records.append(_record(state, s, q, span, structure.motor_dofs))
    return Context(structure, tuple(records), values[structure.slices["spring"]])


def _inferred(state: State, place: tuple[int, int | None]) -> Complex128:
    """(F, ΣN) motion added by the force at ``place`` that best explains the missing torque."""
    a, b = place
    w = state.motion[:, a, :] if b is None else state.motion[:, a, :] - state.motion[:, b, :]
    solved = np.linalg.solve(state.covariance, np.stack((w, state.residual), axis=2))
    information = np.einsum("fm,fm->f", w.conj(), solved[..., 0]).real
    raw = -np.einsum("fm,fm->f", w.conj(), solved[..., 1]) / np.maximum(information, 1e-300)
    noise = 1.0 / np.maximum(information, 1e-300)
    weight = information / max(float(information.max()), 1e-300)
    power = max(float((weight * (np.abs(raw) ** 2 - noise)).sum() / weight.sum()), 0.0)
    y = state.inner[:, :, a] if b is None else state.inner[:, :, a] - state.inner[:, :, b]
    moved: Complex128 = y * (raw * power / (power + noise))[:, None]
    return moved


def _record(
    state: State, s: LineSpectra, q: Complex128, span: tuple[float, float], motors: tuple[int, ...]
) -> RecordMotion:
    block = state.block
    wave = np.asarray(s.position_wave)
    count, rate = wave.shape[0], s.sample_rate_hz
    index = np.round(block.omega / (2 * np.pi) * count / rate).astype(np.int64)
    top = int(index[-1])
    n = int(2 ** np.ceil(np.log2(OVERSAMPLE * top)))
    periodic = not (s.transient and s.periods == 1)
    omega = 2 * np.pi * np.arange(n // 2 + 1) * rate / count
    # A record that does not close keeps the line between its ends apart.
    slope = np.zeros(wave.shape[1]) if periodic else wave[-1] - wave[0]
    base = np.fft.rfft(wave - np.arange(count)[:, None] / count * slope, axis=0)[: top + 1] * (n / count)
    dofs = state.motion.shape[1]
    spectrum = np.zeros((n // 2 + 1, dofs), dtype=complex)
    owner = np.searchsorted(np.asarray(motors), np.arange(dofs), side="right") - 1
    for c in range(dofs):
        a = motors[owner[c]]
        spectrum[: top + 1, c] = base[:, owner[c]]
        if c != a:
            delta = (q[:, c] - q[:, a]) * (n / 2.0)
            spectrum[index[index > 0], c] += delta[index > 0]
    position = np.fft.irfft(spectrum, n, axis=0)
    velocity = np.fft.irfft(1j * omega[:, None] * spectrum, n, axis=0)
    position += np.arange(n)[:, None] / n * slope[owner]
    velocity += slope[owner] * rate / count
    noise = np.median(np.einsum("fcc->fc", block.covariance).real, axis=0)
    return RecordMotion(
        block,
        noise,
        index,
        state.motion,
        state.stiffness,
        q,
        position,
        velocity,
        _resampled(np.asarray(s.torque_wave), n),
        periodic,
        *span,
    )


def _resampled(wave: Float64, n: int) -> Float64:
    """(n, C) the waveform on n points, by its Fourier series."""
    count = wave.shape[0]
    spectrum = np.fft.rfft(wave, axis=0)
    keep = min(count, n) // 2
    out = np.zeros((n // 2 + 1, wave.shape[1]), dtype=complex)
    out[:keep] = spectrum[:keep] * (n / count)
    result: Float64 = np.fft.irfft(out, n, axis=0)
    return result
