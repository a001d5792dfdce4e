"""Identify machines with springs to ground: no rigid motion, so the sum rule gives no mass."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from invid.errors import InvidError
from invid.likelihood.fit import Fit, fit_structure
from invid.model.chains import CoupledChains
from invid.model.parameters import ChainStructure
from invid.numerics import budget
from invid.numerics.arrays import Float64
from invid.signals.spectra import LineSpectra

BETTER = 4.0
"""Factor by which χ² must fall (empirical): as for any other structure, a factor of two in amplitude."""
SIGNIFICANT = 3.0
"""Standard deviations below which a spring to ground is dropped (statistical)."""


def fit_ground_springs(
    spectra: Sequence[LineSpectra],
    free: Fit,
    starts_for: Callable[[Sequence[LineSpectra]], Iterable[CoupledChains]],
) -> Fit:
    """The fit with a spring from each motor to ground where that is better by far; else the ``free`` one.

    Without the torque of that spring the machine is free: T − K_g Θ drives the chains alone. A first K_g is
    read from the lowest lines, and the free starts are drawn from the records corrected by it.
    """
    stiffness = _static_stiffness(spectra)
    grounded = tuple(int(i) for i in np.flatnonzero(stiffness > 0))
    if not grounded:
        return free
    corrected = [replace(s, torque=s.torque - stiffness * s.position) for s in spectra]
    found = free
    while grounded and not budget.is_spent():
        structure = replace(_free_structure(free.structure), grounded=grounded)
        starts = [
            replace(c, ground_springs=np.where(np.isin(np.arange(stiffness.size), grounded), stiffness, 0.0))
            for c in starts_for(corrected)
        ]
        try:
            # A first pass tells the machine that stands on a spring; the rest takes three times as long.
            first_pass = fit_structure(spectra, structure, starts, thorough=False)
            if not first_pass.noise_cost < free.noise_cost:
                return free
            found = fit_structure(spectra, structure, [first_pass.chains])
        except (InvidError, np.linalg.LinAlgError):
            return free
        if not found.noise_cost * BETTER < free.noise_cost:
            return free
        part = found.structure.slices["ground_spring"]
        values = found.values[part]
        deviation = np.sqrt(np.diag(found.covariance)[part])
        kept = tuple(i for i, v, d in zip(grounded, values, deviation, strict=True) if v > SIGNIFICANT * d)
        if kept == grounded:
            break
        grounded = kept
    return found if grounded else free


def _free_structure(structure: ChainStructure) -> ChainStructure:
    return ChainStructure(structure.sizes, structure.axes)


def _static_stiffness(spectra: Sequence[LineSpectra]) -> Float64:
    """(M,) spring to ground of each motor from the lowest lines, T = (K_g + jωB)Θ − ω²SΘ; 0 for none."""
    motors = spectra[0].axis_count
    out = np.zeros(motors)
    for i in range(motors):
        rows, right = [], []
        for s in spectra:
            lines = np.flatnonzero(s.excited)[: 4 + 2 * motors]
            w = s.omega[lines]
            own = s.position[lines, i]
            columns = [own, 1j * w * own, *(-(w**2) * s.position[lines, j] for j in range(motors))]
            weight = 1.0 / np.maximum(np.abs(s.torque[lines, i]), 0.1 * np.abs(s.torque[lines, i]).max())
            rows.append(np.stack(columns, axis=1) * weight[:, None])
            right.append(s.torque[lines, i] * weight)
        matrix, goal = np.concatenate(rows), np.concatenate(right)
        size = np.linalg.norm(matrix, axis=0)
        size[size == 0] = 1.0
        both = np.concatenate((matrix.real, matrix.imag)) / size
        x = np.linalg.lstsq(both, np.concatenate((goal.real, goal.imag)), rcond=1e-8)[0] / size
        out[i] = max(float(x[0]), 0.0)
    return out
