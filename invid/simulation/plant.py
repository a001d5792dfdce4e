"""The linear plant with its linear effects, discretised exactly for one sub-step."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg

from invid.model.chains import CoupledChains
from invid.model.matrices import Matrices, coupling, damper, mass, spring
from invid.numerics.arrays import Float64
from invid.simulation.laws import Laws


@dataclass(frozen=True, eq=False)
class Step:
    """x⁺ = Φx + Γf + R(f⁺ − f): ``transition`` (2n, 2n), ``held`` and ``ramp`` (2n, n), ``length`` [s]."""

    transition: Float64
    held: Float64
    ramp: Float64
    length: float

    @cached_property
    def compiled(self) -> tuple[Float64, Float64, Float64, float]:
        """As the kernel takes it."""
        made = (np.ascontiguousarray(m.T) for m in (self.transition, self.held, self.ramp))
        return next(made), next(made), next(made), 0.5 * self.length


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


def discretise(plant: Matrices, step: float) -> Step:
    """Exact step of length ``step`` [s] for forces on the coordinates that are held or rise evenly."""
    n = plant.mass.shape[0]
    # one exponential for all (Van Loan)
    big = np.zeros((4 * n, 4 * n))
    big[: 2 * n, : 2 * n] = plant.rates * step
    big[n : 2 * n, 2 * n : 3 * n] = np.linalg.inv(plant.mass) * step
    big[2 * n : 3 * n, 3 * n :] = np.eye(n)
    power = scipy.linalg.expm(big)[: 2 * n]
    return Step(power[:, : 2 * n], power[:, 2 * n : 3 * n], power[:, 3 * n :], step)
