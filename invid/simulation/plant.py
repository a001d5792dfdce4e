"""The linear plant with its linear effects, discretised exactly for one sub-step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from invid.model.chains import CoupledChains, add_link
from invid.model.forward import natural_frequencies
from invid.numerics.arrays import Float64
from invid.simulation.laws import Laws


@dataclass(frozen=True, eq=False)
class Matrices:
    """Mass, damping and stiffness over all coordinates, extra masses appended."""

    mass: Float64
    damping: Float64
    stiffness: Float64

    @property
    def fastest(self) -> float:
        """Largest natural frequency [rad/s]."""
        return float(natural_frequencies(self.mass, self.stiffness)[-1])


@dataclass(frozen=True, eq=False)
class Step:
    """x⁺ = transition x + now u_k + next u_{k+1} + force f (see ``kernel``)."""

    transition: Float64
    now: Float64
    next: Float64
    force: Float64


def matrices(chains: CoupledChains, laws: Laws) -> Matrices:
    """Matrices with viscous friction, spring damping, coupling stiffness, extra masses, then bases in."""
    extra = len(laws.extra_masses) + len(laws.bases)
    size = chains.dofs + extra
    mass, damping, stiffness = (np.zeros((size, size)) for _ in range(3))
    inner = slice(0, chains.dofs)
    mass[inner, inner] = chains.mass_matrix
    damping[inner, inner] = chains.damping_matrix
    stiffness[inner, inner] = chains.stiffness_matrix
    for spring in laws.stiffness:
        add_link(stiffness, spring.a, spring.b, spring.stiffness)
    for damper in laws.damping:
        add_link(damping, damper.a, damper.b, damper.coefficient)
    for number, extra_mass in enumerate(laws.extra_masses):
        new, m, k = chains.dofs + number, extra_mass.mass, extra_mass.stiffness
        mass[new, new] = m
        add_link(stiffness, extra_mass.at, new, k)
        add_link(damping, extra_mass.at, new, 2 * extra_mass.damping_ratio * float(np.sqrt(k * m)))
    for number, base in enumerate(laws.bases):
        new = chains.dofs + len(laws.extra_masses) + number
        mass[new, new], stiffness[new, new], damping[new, new] = base.mass, base.stiffness, base.damper
        mass[new, chains.end_dofs] = mass[chains.end_dofs, new] = base.force
    return Matrices(mass, damping, stiffness)


def discretise(plant: Matrices, inputs: Float64, step: float) -> Step:
    """Exact step of length ``step`` [s] for piecewise linear inputs and piecewise constant forces.

    ``inputs`` (n, M): force patterns of the inputs on the coordinates.
    """
    n, count = plant.mass.shape[0], inputs.shape[1]
    inverse = np.linalg.inv(plant.mass)
    system = np.zeros((2 * n, 2 * n))
    system[:n, n:] = np.eye(n)
    system[n:, :n] = -inverse @ plant.stiffness
    system[n:, n:] = -inverse @ plant.damping
    drive = np.zeros((2 * n, count))
    drive[n:] = inverse @ inputs
    push = np.zeros((2 * n, n))
    push[n:] = inverse
    # one exponential for constant forces, constant inputs and their ramps (Van Loan)
    big = np.zeros((2 * n + n + 2 * count,) * 2)
    big[: 2 * n, : 2 * n] = system * step
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
