"""A chain with one mass more: the missing mode, estimated from the residual of the smaller chain's fit.

A mode whose resonance and antiresonance lie close together is no peak that modes are read from, and a start
without it has no way there. In the compliance at the motor, Σ φ²/(ω_k² − ω²), it is one small term more; the
missing torque tells its frequency and its size to first order, and the Lanczos recursion makes a chain of all
modes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.errors import InvidError
from invid.inverse.lanczos import lanczos
from invid.inverse.springs import last_mass, springs_and_masses
from invid.likelihood.fit import Fit
from invid.likelihood.nuisance.torque_channel import channel_torque
from invid.likelihood.residual import MissingTorqueProblem, State
from invid.model.chains import CoupledChains
from invid.numerics.arrays import Complex128, Float64
from invid.numerics.whitening import stack

LOSS_FACTORS = (0.005, 0.02, 0.08)
"""Loss factors of the further mode that are tried (physical: harmonic drives and gears lie between)."""
FREQUENCIES_AT_ONCE = 64
"""Frequencies whose modes are held in memory together."""


@dataclass(frozen=True)
class MissingMode:
    """The mode that reduces χ² most, with its gain when everything else is linearised."""

    omega: float
    """[rad/s]"""
    share: float
    """φ² at the motor [1/kg or 1/(kg·m²)]."""
    gain: float


def missing_mode(fit: Fit) -> MissingMode | None:
    """The mode that the fit of a single free branch lacks; ``None`` for others, or where none would help."""
    sizes = fit.chains.masses_per_branch
    if len(sizes) != 1 or sizes[0] < 2 or np.any(fit.chains.ground_springs):
        return None
    problem, p = fit.problem, fit.solution.p
    residual, jacobian = problem.evaluate(p)
    basis, _ = np.linalg.qr(jacobian / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300))
    remainder = residual - basis @ (basis.T @ residual)
    states = problem.states(p)
    torques = [_plant_torque(problem, s, p) for s in states]
    omega = np.concatenate([s.block.omega for s in states])
    found: MissingMode | None = None
    for loss in LOSS_FACTORS:
        grid = _frequency_grid(omega[omega > 0], loss)
        for at in np.array_split(grid, -(-grid.size // FREQUENCIES_AT_ONCE)):
            rows = []
            for s, torque in zip(states, torques, strict=True):
                line = s.block.omega[:, None]
                column = -s.stiffness[:, 0] * torque / (at**2 - line**2 + 1j * loss * at * line)
                white = stack(s.root @ column[:, None])
                rows.append(white - s.basis @ (s.basis.T @ white))
            # What is known beforehand.
            rows.append(np.zeros((residual.size - sum(len(r) for r in rows), at.size)))
            own = np.concatenate(rows)
            own = own - basis @ (basis.T @ own)
            power, along = np.sum(own**2, axis=0), remainder @ own
            gain = np.where((power > 0) & (along < 0), along**2 / np.maximum(power, 1e-300), 0.0)
            strongest = int(gain.argmax())
            if gain[strongest] > (0.0 if found is None else found.gain):
                share = float(-along[strongest] / power[strongest])
                found = MissingMode(float(at[strongest]), share, float(gain[strongest]))
    return found


def _plant_torque(problem: MissingTorqueProblem, state: State, p: Float64) -> Complex128:
    """(F, M) torque on the plant: that of the drive without friction.

    Not Z·Θ: where a record does not close, most of that may be a contribution of its ends.
    """
    block, s = state.block, problem.slices
    channel = channel_torque(block, p[s["delay"]], p[s["staircase"]])
    driven: Complex128 = channel.factor * block.torque + channel.hold * block.position
    return driven - block.columns @ p[s["column"]]


def _frequency_grid(omega: Float64, loss: float) -> Float64:
    """Grid of frequencies [rad/s] no wider than the half-power width of a mode with that loss, or than the
    lines."""
    first, last = float(omega.min()), float(omega.max())
    spacing = (last - first) / max(np.unique(omega).size - 1, 1)
    linear = np.arange(first, min(spacing / loss, last), spacing) if spacing > 0 else omega[:1]
    start = max(first, spacing / loss)
    geometric = np.geomspace(start, last, 2 + int(np.log(last / start) / loss)) if last > start else omega[:0]
    return np.concatenate((linear, geometric))


def chains_with_mode(chains: CoupledChains, mode: MissingMode) -> list[CoupledChains]:
    """The free chain with one mode more, as a start; empty where no chain has those modes."""
    root = np.sqrt(chains.masses[0])
    squares, shapes = np.linalg.eigh(chains.stiffness_matrix / root[:, None] / root)
    weights = np.append((shapes[0] / root[0]) ** 2, mode.share)
    poles = np.append(np.maximum(squares, 0.0), mode.omega**2)
    order = np.argsort(poles)
    rows = lanczos(poles[order], np.sqrt(weights[order]), poles.size - 1)
    if rows.diagonal.size < poles.size - 1:
        return []
    masses, springs = springs_and_masses(rows, 1.0 / float(weights.sum()), poles.size)
    masses = np.append(masses, last_mass(float(chains.masses[0].sum()), masses))
    loss = float(np.median(chains.dampers[0] / chains.springs[0]))
    try:
        return [CoupledChains.build([masses], [springs], [loss * springs], axes=chains.axes)]
    except InvidError:
        return []


__all__ = ["MissingMode", "chains_with_mode", "missing_mode"]
