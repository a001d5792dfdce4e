"""The linear plant with its linear effects, discretised exactly for one sub-step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from invid.model.chains import CoupledChains
from invid.model.matrices import Matrices, coupling, damper, mass, spring
from invid.numerics.arrays import Float64
from invid.simulation.laws import Laws


@dataclass(frozen=True, eq=False)
class Step:
    """x⁺ = transition x + now u_k + next u_{k+1} + force f (see ``kernel``)."""

    transition: Float64
    now: Float64
    next: Float64
    force: Float64


def matrices(chains: CoupledChains, laws: Laws) -> Matrices:
    """Matrices with viscous friction, spring damping, coupling stiffness, extra masses, then bases in."""
    parts = [*chains.parts, *(spring(k.stiffness, k.a, k.b) for k in laws.stiffness)]
    parts += [damper(d.coefficient, d.a, d.b) for d in laws.damping]
    for new, extra in enumerate(laws.extra_masses, chains.dofs):
        loss = 2 * extra.damping_ratio * float(np.sqrt(extra.stiffness * extra.mass))
        parts += [mass(extra.mass, new), spring(extra.stiffness, extra.at, new), damper(loss, extra.at, new)]
    for new, base in enumerate(laws.bases, chains.dofs + len(laws.extra_masses)):
        parts += [mass(base.mass, new), spring(base.stiffness, new), damper(base.damper, new)]
        parts += [coupling(f, end, new) for end, f in zip(chains.end_dofs.tolist(), base.force, strict=True)]
    return Matrices.of(chains.dofs + len(laws.extra_masses) + len(laws.bases), parts)


def discretise(plant: Matrices, inputs: Float64, step: float) -> Step:
    """Exact step of length ``step`` [s] for piecewise linear inputs and piecewise constant forces.

    ``inputs`` (n, M): force patterns of the inputs on the coordinates.
    """
    n, count = plant.mass.shape[0], inputs.shape[1]
    inverse = np.linalg.inv(plant.mass)
    drive = np.zeros((2 * n, count))
    drive[n:] = inverse @ inputs
    push = np.zeros((2 * n, n))
    push[n:] = inverse
    # one exponential for constant forces, constant inputs and their ramps (Van Loan)
    big = np.zeros((2 * n + n + 2 * count,) * 2)
    big[: 2 * n, : 2 * n] = plant.rates * step
    big[: 2 * n, 2 * n : 3 * n] = push * step
    big[: 2 * n, 3 * n : 3 * n + count] = drive * step
    big[3 * n : 3 * n + count, 3 * n + count :] = np.eye(count)
    power = scipy.linalg.expm(big)
    constant, ramp = power[: 2 * n, 3 * n : 3 * n + count], power[: 2 * n, 3 * n + count :]
    return Step(
        np.ascontiguousarray(power[: 2 * n, : 2 * n]),
        np.ascontiguousarray(constant - ramp),
        np.ascontiguousarray(ramp),
        np.ascontiguousarray(power[: 2 * n, 2 * n : 3 * n]),
    )
