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
from invid.inverse.springs import last_mass, springs_and_masses
from invid.likelihood.fit import Fit
from invid.model.chains import CoupledChains
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
    root = np.sqrt(chains.masses[0])
    squares, shapes = np.linalg.eigh(chains.stiffness_matrix / root[:, None] / root)
    weights = np.append((shapes[0] / root[0]) ** 2, share)
    poles = np.append(np.maximum(squares, 0.0), at**2)
    order = np.argsort(poles)
    rows = lanczos(poles[order], np.sqrt(weights[order]), poles.size - 1)
    if rows.diagonal.size < poles.size - 1:
        return []
    masses, springs = springs_and_masses(rows, 1.0 / float(weights.sum()), poles.size)
    masses = np.append(masses, last_mass(float(chains.masses[0].sum()), masses))
    lossy = float(np.median(chains.dampers[0] / chains.springs[0]))
    try:
        return [CoupledChains.build([masses], [springs], [lossy * springs], axes=chains.axes)]
    except InvidError:
        return []


__all__ = ["with_further_mode"]
