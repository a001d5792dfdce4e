"""The FRF matrix G = Θ T⁻¹ over several experiments: the open-loop plant under any hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.numerics.arrays import Complex128, Float64
from invid.signals.record import Record

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


def frf_matrix(records: Sequence[Record]) -> FrfMatrix:
    """Least-squares G over all records, on the lines that span every axis; empty where none does.

    Lines of different records belong together when they differ by less than a tenth of the finest spacing.
    """
    motors = records[0].hold.size if records else 0
    spacing = min((max(r.periods, 1) / r.span for r in records), default=1.0)
    gathered: dict[int, list[tuple[Record, int]]] = {}
    for r in records:
        for line in r.carrying.tolist():
            gathered.setdefault(round(r.wide[line] / (2 * np.pi * spacing) * 5), []).append((r, line))
    power = np.sqrt(sum((np.abs(r.torque[r.carrying]) ** 2).sum(axis=0) for r in records))
    power = np.where(power > 0, power, 1.0)
    rows = []
    for members in (gathered[key] for key in sorted(gathered)):
        torque = np.stack([r.torque[k] for r, k in members], axis=1)
        size = np.linalg.svd(torque / power[:, None], compute_uv=False)
        if len(members) < motors or size[-1] < LEAST_SINGULAR_RATIO * size[0]:
            continue
        inverse = np.linalg.pinv(torque)
        g = np.stack([r.closed_position[k] for r, k in members], axis=1) @ inverse
        both = np.abs(np.concatenate((np.eye(motors), -g), axis=1)) ** 2
        noise = [both @ np.concatenate((r.position_noise, r.torque_noise)) for r, _ in members]
        hz = np.mean([r.wide[k] for r, k in members]) / (2 * np.pi)
        rows.append((hz, g, np.stack(noise, axis=1) @ np.abs(inverse) ** 2))
    if not rows:
        nothing = np.zeros((0, motors, motors))
        return FrfMatrix(np.zeros(0), nothing.astype(np.complex128), nothing)
    return FrfMatrix(*(np.array(column) for column in zip(*rows, strict=True)))
