"""What a machine weighs on the lowest lines, where it moves nearly as if nothing bent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.numerics.arrays import Complex128, Float64
from invid.signals.spectral_record import Record

LOWEST = 3
"""Lines of each record, from the lowest, on which a machine is taken for rigid."""


def rigid(
    records: Sequence[Record], motors: int, pair: tuple[int, int] | None = None
) -> tuple[Float64, float]:
    """(M,) inertia of every branch [kg·m² or kg], and the stiffness between a ``pair`` of them where one is
    given [N·m/rad or N/m], from the torque of the lowest excited lines. Zeros where there are none."""
    rows, columns = np.triu_indices(motors)
    left: list[Complex128] = []
    right: list[Complex128] = []
    for record in records:
        for k in np.flatnonzero(record.excited & (record.omega > 0))[:LOWEST]:
            position = record.position[k]
            moved = -(record.omega[k] ** 2) * position
            on = np.zeros((motors, rows.size + (pair is not None)), dtype=complex)
            for column, (i, j) in enumerate(zip(rows, columns, strict=True)):
                on[i, column] = moved[j]
                on[j, column] = moved[i]
            if pair is not None:
                between = position[pair[0]] - position[pair[1]]
                on[pair[0], -1], on[pair[1], -1] = between, -between
            left.append(on)
            right.append(record.torque[k])
    if not left:
        return np.zeros(motors), 0.0
    a, b = np.concatenate(left), np.concatenate(right)
    found = np.linalg.lstsq(np.concatenate((a.real, a.imag)), np.concatenate((b.real, b.imag)), rcond=None)[0]
    return np.asarray(found[: rows.size][rows == columns]), float(found[-1]) if pair is not None else 0.0


__all__ = ["rigid"]
