"""A chain with one mass more, from what the fit of the smaller one leaves: the mode that is missing.

A mode whose resonance and antiresonance lie close together is no peak that modes are read from, and a start
without it has no way there. In the compliance at the motor, Σ φ²/(ω_k² − ω²), it is one small term more; the
missing torque tells its frequency and its size to first order, and the Lanczos recursion makes a chain of all
modes.
"""

from __future__ import annotations

import numpy as np

from invid.errors import InvidError
from invid.inverse.lanczos import lanczos
from invid.likelihood.fit import Fit
from invid.model.chains import CoupledChains
from invid.numerics.arrays import Float64
from invid.numerics.whitening import stack

TRIED = 300
"""Frequencies that are tried, evenly over those of the records."""
LOSS = (0.005, 0.02, 0.08)
"""Loss factors of the further mode that are tried: harmonic drives and gears lie between."""


def with_further_mode(fit: Fit) -> list[CoupledChains]:
    """A start with one mass more for a single free branch; none for others, or where no mode is missing."""
    sizes = fit.chains.masses_per_branch
    if len(sizes) != 1 or sizes[0] < 2 or np.any(fit.chains.ground_springs):
        return []
    mode = _missing_mode(fit)
    return [] if mode is None else _extended(fit.chains, *mode)


def _missing_mode(fit: Fit) -> tuple[float, float] | None:
    """Frequency [rad/s] and φ² [1/kg or 1/(kg·m²)] of the mode that the missing torque asks for most."""
    problem, p = fit.problem, fit.solution.p
    residual, jacobian = problem.evaluate(p)
    basis, _ = np.linalg.qr(jacobian / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300))
    left = residual - basis @ (basis.T @ residual)
    states = problem.states(p)
    omega = np.concatenate([s.block.omega for s in states])
    best, found = 0.0, None
    for at in np.quantile(omega, np.linspace(0.0, 1.0, TRIED)):
        for loss in LOSS:
            rows = []
            for s in states:
                line = s.block.omega
                felt = -(s.stiffness[:, 0, 0] ** 2) * s.projected_position[:, 0]
                column = (felt / (at**2 - line**2 + 1j * loss * at * line))[:, None, None]
                white = stack(s.root @ column)[:, 0]
                rows.append(white - s.basis @ (s.basis.T @ white))
            rows.append(np.zeros(residual.size - sum(r.size for r in rows)))  # what is known beforehand
            own = np.concatenate(rows)
            own = own - basis @ (basis.T @ own)
            power, along = float(own @ own), float(own @ left)
            if power > 0 and along < 0 and along**2 / power > best:
                best, found = along**2 / power, (float(at), -along / power)
    return found


def _extended(chains: CoupledChains, at: float, share: float) -> list[CoupledChains]:
    """The free chain with one more mode at ``at`` [rad/s] of φ² ``share`` at the motor."""
    masses, springs, dampers = chains.masses[0], chains.springs[0], chains.dampers[0]
    root = np.sqrt(masses)
    stiffness = np.zeros((masses.size, masses.size))
    for s, k in enumerate(springs):
        stiffness[s : s + 2, s : s + 2] += k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    squares, shapes = np.linalg.eigh(stiffness / root[:, None] / root)
    weights = np.append(shapes[0] ** 2 / masses[0], share)
    poles = np.append(np.maximum(squares, 0.0), at**2)
    order = np.argsort(poles)
    rows = lanczos(poles[order], np.sqrt(weights[order]), poles.size)
    if rows.diagonal.size < poles.size:
        return []
    further = _masses(1.0 / float(weights.sum()), rows.diagonal, rows.off_diagonal)
    pulls = rows.off_diagonal[:-1] * np.sqrt(further[:-1] * further[1:])
    lossy = float(np.median(dampers / springs))
    try:
        return [CoupledChains.build([further], [pulls], [lossy * pulls], axes=chains.axes)]
    except InvidError:
        return []


def _masses(first: float, diagonal: Float64, beside: Float64) -> Float64:
    """(N,) masses of a free chain whose B has this diagonal and, with a minus, these neighbours: B √m = 0."""
    root = np.zeros(diagonal.size)
    root[0] = np.sqrt(first)
    for k in range(diagonal.size - 1):
        before = beside[k - 1] * root[k - 1] if k else 0.0
        root[k + 1] = (diagonal[k] * root[k] - before) / beside[k]
    masses: Float64 = root**2
    return masses


__all__ = ["with_further_mode"]
