"""How much torque on which line: the powers that make the believed plant's parameters best known.

Lines are interleaved: line k belongs to axis k mod M. In the steady state the information of a record
is a sum over lines, each proportional to its power, M(w) = Σ w_l M_l; the powers that minimise the
scaled trace of M⁻¹ (A-optimality) under a budget for each axis come from the multiplicative algorithm
(Silvey, Titterington, Torsney 1978). The budget is torque power, plus a price on travel and speed where
those limits are near.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.likelihood.residual import condense_dense
from invid.model.parameters import ChainStructure, structure_of
from invid.numerics.arrays import Complex128, Float64, Int64
from invid.planning.belief import Belief

ITERATIONS = 40
"""Of the multiplicative algorithm: within 2 % of the optimum from there on (case study)."""
ROBUST_SHARE = 0.3
"""Share of the power kept on f^−½ over all lines, for a plant that has moved since the model was made."""


@dataclass(frozen=True, eq=False)
class LineDesign:
    """Relative amplitudes of every line.

    Attributes
    ----------
    lines, axis
        (L,) line numbers, and the axis each is given to.
    amplitude
        (L,) relative within an axis; the sum of squares is 1 on each.
    """

    lines: Int64
    axis: Int64
    amplitude: Float64

    def of(self, axis: int) -> tuple[Int64, Float64]:
        """Lines and amplitudes of one axis."""
        own = self.axis == axis
        return self.lines[own], self.amplitude[own]


def interleaved(lines: Int64, excited: Sequence[int], turn: int = 0) -> Int64:
    """(L,) axis of each line; ``turn`` moves the pattern on, so that blocks complement each other."""
    result: Int64 = np.asarray(excited, dtype=np.int64)[(np.arange(lines.size) + turn) % len(excited)]
    return result


def line_design(
    belief: Belief,
    lines: Int64,
    spacing_hz: float,
    axis: Int64,
    *,
    hold: tuple[Float64, Float64],
    torque_noise: Float64,
    position_noise: Float64,
    goal_scale: Float64 | None,
    prices: tuple[Float64, Float64],
    robust_share: float = ROBUST_SHARE,
) -> LineDesign:
    """The design of one record.

    Parameters
    ----------
    hold
        (M,) stiffness and damping of the hold of every axis.
    torque_noise, position_noise
        (M,) standard deviations per sample (only their ratio to each other matters).
    goal_scale
        (n,) scale of the structure's parameters in fit units; infinite for those that do not matter.
        ``None``: amplitudes ∝ f^−½, no optimisation.
    prices
        (M,) price of travel² and of speed² of each motor beside a torque² of 1.
    robust_share
        Share of the power kept on f^−½.
    """
    structure = structure_of(belief.chains)
    p = structure.vector(belief.chains)
    p[structure.slices["viscous"]][: structure.motors] = belief.viscous
    omega: Float64 = np.asarray(2 * np.pi * spacing_hz * lines, dtype=np.float64)
    motion, plant, _ = condense_dense(structure, p, omega)
    motors = structure.motors
    law = hold[0] + 1j * omega[:, None] * hold[1]
    index = np.arange(motors)
    closed = plant.copy()
    closed[:, index, index] += law
    push = np.eye(motors)[axis]
    unit_push: Complex128 = push[..., None].astype(np.complex128)
    theta: Complex128 = np.asarray(np.linalg.solve(closed, unit_push)[..., 0], dtype=np.complex128)
    travel = np.abs(theta)
    speed = omega[:, None] * travel
    robust = _normalised(1.0 / np.maximum(lines, 1).astype(float), axis)  # power ∝ 1/f
    cost = 1.0 + travel**2 @ prices[0] + speed**2 @ prices[1]
    if goal_scale is None:
        power = _normalised(robust / cost, axis)
        return LineDesign(lines, axis, np.sqrt(power))
    torque: Complex128 = np.asarray(push - law * theta, dtype=np.complex128)
    matrices = _information(structure, p, omega, motion, plant, theta, torque, torque_noise, position_noise)
    weight = _normalised(np.full(lines.size, 1.0) / cost, axis)
    importance = np.where(np.isfinite(goal_scale), 1.0 / goal_scale, 0.0)
    importance = np.concatenate((importance, np.zeros(matrices.shape[1] - importance.size)))
    ruler = np.sqrt(np.maximum(np.einsum("l,lkk->k", weight, matrices), 1e-300))
    scaled = matrices / ruler[:, None] / ruler
    for _ in range(ITERATIONS):
        total = np.einsum("l,lab->ab", weight, scaled)
        # What the band cannot show must not blow up the rest: a millionth of the scaled information.
        inverse = np.linalg.inv(total + 1e-6 * np.eye(total.shape[0]))
        root = inverse * (importance / ruler)
        gain = np.einsum("ab,lbc,ca->l", root.T, scaled, root).real
        weight = _normalised(weight * np.sqrt(np.maximum(gain, 0.0) / cost), axis, cost)
    power = (1 - robust_share) * weight + robust_share * _normalised(robust, axis, cost)
    return LineDesign(lines, axis, np.sqrt(_normalised(power, axis)))


def _normalised(power: Float64, axis: Int64, cost: Float64 | None = None) -> Float64:
    spent = power if cost is None else power * cost
    sums = np.bincount(axis, weights=spent, minlength=int(axis.max()) + 1)
    result: Float64 = power / np.maximum(sums[axis], 1e-300)
    return result


def _information(
    structure: ChainStructure,
    p: Float64,
    omega: Float64,
    motion: Complex128,
    plant: Complex128,
    theta: Complex128,
    torque: Complex128,
    torque_noise: Float64,
    position_noise: Float64,
) -> Float64:
    """(L, n + M, n + M) Fisher information of unit torque on each line; time offsets are the last M."""
    q = np.einsum("fqm,fm->fq", motion, theta)
    jacobian = structure.torque_derivative(p, omega, motion, q[None])[0]
    offset = np.zeros((omega.size, structure.motors, structure.motors), dtype=complex)
    index = np.arange(structure.motors)
    offset[:, index, index] = 1j * omega[:, None] * torque
    both = np.concatenate((jacobian, offset), axis=2)
    noise = np.einsum("fij,j,fkj->fik", plant, position_noise**2 + 0j, plant.conj())
    noise = noise + np.diag(torque_noise**2)
    result: Float64 = np.einsum("fia,fib->fab", both.conj(), np.linalg.solve(noise, both)).real
    return result
