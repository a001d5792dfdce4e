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
