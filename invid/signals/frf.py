"""The FRF matrix G = Θ T⁻¹ over several experiments: the open-loop plant under any hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.numerics.arrays import Complex128, Float64
from invid.signals.spectra import LineSpectra

LEAST_SINGULAR_RATIO = 1e-3
"""Smallest ratio of the singular values of T (axes scaled to equal power) for a line to count: below
it the M torques are as good as parallel and noise is amplified a thousandfold."""


@dataclass(frozen=True, eq=False)
class FrfMatrix:
    """Receptance at the motors.

    ``frequency_hz`` (F,), ``frf`` (F, M, M) [rad/(N·m) or m/N], ``variance`` (F, M, M) of E|n|².
    """

    frequency_hz: Float64
    frf: Complex128
    variance: Float64

    @classmethod
    def empty(cls, motors: int) -> FrfMatrix:
        """No line at all."""
        nothing = np.zeros((0, motors, motors))
        return cls(np.zeros(0), nothing.astype(np.complex128), nothing)


def frf_matrix(spectra: Sequence[LineSpectra], *, delay_s: float = 0.0) -> FrfMatrix:
    """Least-squares G over all experiments, on the lines that span every axis.

    Lines of different experiments belong together when they differ by less than a tenth of the
    finest spacing. Empty where no line spans every axis.

    ``delay_s``: how much later the torque acts than it is recorded.
    """
    motors = spectra[0].axis_count
    spacing = min(float(np.diff(s.frequency_hz).min(initial=np.inf)) for s in spectra)
    spacing = spacing if np.isfinite(spacing) else float(spectra[0].frequency_hz[0])
    gathered: dict[int, list[tuple[int, int]]] = {}
    for number, s in enumerate(spectra):
        lines = np.flatnonzero(s.excited)
        for line in lines:
            gathered.setdefault(round(float(s.frequency_hz[line]) / spacing * 5), []).append(
                (number, int(line))
            )
    hz, values, variances = [], [], []
    power = np.sqrt(np.mean([(np.abs(s.torque[s.excited]) ** 2).mean(axis=0) for s in spectra], axis=0))
    power[~(power > 0)] = 1.0
    for key in sorted(gathered):
        members = gathered[key]
        if len(members) < motors:
            continue
        theta = np.stack([spectra[n].position[k] for n, k in members], axis=1)
        torque = np.stack([spectra[n].torque[k] for n, k in members], axis=1)
        size = np.linalg.svd(torque / power[:, None], compute_uv=False)
        if size[-1] < LEAST_SINGULAR_RATIO * size[0]:
            continue
        frequency = float(np.mean([spectra[n].frequency_hz[k] for n, k in members]))
        inverse = np.linalg.pinv(torque)
        g = theta @ inverse
        both = np.concatenate((np.eye(motors), -g), axis=1)
        noise = np.stack([(np.abs(both) ** 2) @ spectra[n].floor for n, _ in members], axis=1)  # (M, members)
        hz.append(frequency)
        values.append(g * np.exp(2j * np.pi * frequency * delay_s))
        variances.append(noise @ (np.abs(inverse) ** 2))
    if not hz:
        return FrfMatrix.empty(motors)
    return FrfMatrix(np.array(hz), np.array(values), np.array(variances))


def local_frf_matrix(spectra: Sequence[LineSpectra], *, lines: int = 160) -> FrfMatrix:
    """G by local regression over neighbouring lines, transients of each record beside it.

    Around each frequency Θ = (G₀ + G₁x + G₂x²)·T + t₀ + t₁x per record that is not settled: what
    leaks from the ends of a record is smooth over lines where the torque of a random-phase
    excitation is not (local polynomial method). Serves records from rest, chirps, and axes whose
    lines interleave. A start for the fit, not a result: resonances narrower than a window are blunted.
    """
    motors = spectra[0].axis_count
    top = max(float(s.frequency_hz[s.excited].max(initial=0.0)) for s in spectra)
    hz = np.concatenate([s.frequency_hz for s in spectra])
    owner = np.repeat(np.arange(len(spectra)), [s.frequency_hz.size for s in spectra])
    use = np.concatenate([s.excited | (s.transient & (s.frequency_hz <= top)) for s in spectra])
    theta = np.concatenate([s.position for s in spectra])[use]
    torque = np.concatenate([s.torque for s in spectra])[use]
    hz, owner = hz[use], owner[use]
    order = np.argsort(hz, kind="stable")
    hz, owner, theta, torque = hz[order], owner[order], theta[order], torque[order]
    is_transient = [n for n, s in enumerate(spectra) if s.transient]
    unknowns = 3 * motors + 2 * len(is_transient)
    window = int(1.7 * unknowns) + 2
    if hz.size < window:
        return FrfMatrix.empty(motors)
    scale = np.sqrt(np.mean(np.abs(torque) ** 2, axis=0))
    scale[scale == 0] = 1.0
    grid = np.unique(np.linspace(0, hz.size - 1, min(lines, hz.size)).astype(int))
    keep, values, variances = [], [], []
    for centre in grid:
        low = int(np.clip(centre - window // 2, 0, hz.size - window))
        part = slice(low, low + window)
        x = (hz[part] - hz[centre]) / max(hz[part][-1] - hz[part][0], 1e-300)
        t = torque[part] / scale
        columns = [t, t * x[:, None], t * x[:, None] ** 2]
        for n in is_transient:
            own = (owner[part] == n).astype(complex)
            columns.append(np.stack((own, own * x), axis=1))
        matrix = np.concatenate(columns, axis=1)
        size = np.linalg.norm(matrix, axis=0)
        matrix = matrix[:, size > 0] / size[size > 0]
        if not np.all(size[:motors] > 0):
            continue
        solution, _, rank, singular = np.linalg.lstsq(matrix, theta[part], rcond=None)
        if rank < matrix.shape[1] or singular[-1] < 1e-6 * singular[0]:
            continue
        residual = theta[part] - matrix @ solution
        free = max(window - matrix.shape[1], 1)
        inverse = np.linalg.inv(matrix.conj().T @ matrix).real
        gain = (solution[:motors] / size[:motors, None] / scale[:, None]).T
        spread = np.diag(inverse)[:motors] / size[:motors] ** 2 / scale**2
        power = (np.abs(residual) ** 2).sum(axis=0) / free
        keep.append(float(hz[centre]))
        values.append(gain)
        variances.append(power[:, None] * spread)
    if not keep:
        return FrfMatrix.empty(motors)
    at, first = np.unique(np.array(keep), return_index=True)
    return FrfMatrix(at, np.array(values)[first], np.maximum(np.array(variances)[first], 1e-300))
