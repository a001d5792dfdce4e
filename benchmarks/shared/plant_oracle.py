"""A cell to measure on that shares no code with the estimator: matrices, matrix exponential, a loop.

Chains of masses and springs with inertia-coupled ends; exact zero-order-hold discretisation at
``substeps`` a sample. Motor friction (Coulomb with stick, viscous) is integrated with the torque of
each substep; holds run in the drive at every substep or in the master once a sample.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class OraclePlant:
    """Masses, springs, dampers per branch; ``couplings`` {(i, j): inertia}; motor friction."""

    masses: list[list[float]]
    springs: list[list[float]]
    dampers: list[list[float]]
    couplings: dict[tuple[int, int], float] = field(default_factory=dict)
    coulomb: tuple[float, ...] = ()
    viscous: tuple[float, ...] = ()

    @property
    def matrices(self) -> tuple[Array, Array, Array, list[int]]:
        """Mass, damping, stiffness and the rows of the motors."""
        mass = np.diag([m for b in self.masses for m in b]).astype(float)
        ends = np.cumsum([len(b) for b in self.masses]) - 1
        for (i, j), value in self.couplings.items():
            mass[ends[i], ends[j]] = mass[ends[j], ends[i]] = value
        motors = [0, *(int(e) + 1 for e in ends[:-1])]
        damping = block_diag(*[_chain(d) for d in self.dampers])
        for row, b in zip(motors, self.viscous, strict=False):
            damping[row, row] += b
        return mass, damping, block_diag(*[_chain(k) for k in self.springs]), motors

    def frf(self, hz: Array) -> NDArray[np.complex128]:
        """(F, M, M) receptance at the motors by a full solve a line."""
        mass, damping, stiffness, motors = self.matrices
        out = np.empty((hz.size, len(motors), len(motors)), complex)
        for k, w in enumerate(2 * np.pi * hz):
            full = np.linalg.inv(stiffness + 1j * w * damping - w**2 * mass)
            out[k] = full[np.ix_(motors, motors)]
        return out


def _chain(values: list[float]) -> Array:
    matrix = np.zeros((len(values) + 1, len(values) + 1))
    for q, value in enumerate(values):
        matrix[q : q + 2, q : q + 2] += value * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return matrix


def case_study(ratio: float = 0.01, **friction: tuple[float, ...]) -> OraclePlant:
    """Section 4 of the paper with about ``ratio`` modal damping."""
    masses = [[0.7, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]
    springs = [[1000.0, 2000.0], [3000.0, 4000.0], [5000.0, 6000.0]]
    couplings = {(0, 1): 1.0, (0, 2): 2.0, (1, 2): 3.0}
    return OraclePlant(masses, springs, _dampers(masses, springs, ratio), couplings, **friction)


def random_plant(rng: np.random.Generator, sizes: list[int], *, ratio: float = 0.01) -> OraclePlant:
    """Masses and springs spread by a factor of 2 either way; couplings up to half the ends' mean."""
    masses = [list(2.0 ** rng.uniform(-1, 1, n)) for n in sizes]
    springs = [list(3000.0 * 2.0 ** rng.uniform(-1, 1, n - 1)) for n in sizes]
    couplings = {}
    for i in range(len(sizes)):
        for j in range(i + 1, len(sizes)):
            bound = 0.6 * np.sqrt(masses[i][-1] * masses[j][-1]) / max(len(sizes) - 1, 1)
            couplings[i, j] = float(rng.choice([0.0, -1.0, 1.0]) * rng.uniform(0.1, 1) * bound)
    return OraclePlant(masses, springs, _dampers(masses, springs, ratio), couplings)


def _dampers(masses: list[list[float]], springs: list[list[float]], ratio: float) -> list[list[float]]:
    return [
        [2 * ratio * float(np.sqrt(k * a * b / (a + b))) for a, b, k in zip(m[:-1], m[1:], ks, strict=True)]
        for m, ks in zip(masses, springs, strict=True)
    ]


@numba.njit(cache=True)  # type: ignore[misc]
def _loop(ad, bd, motors, velocity, demand, gain, damping, in_drive, coulomb, inertia, h, substeps, x):  # type: ignore[no-untyped-def]
    count, axes = demand.shape
    position = np.empty((count, axes))
    torque = np.empty((count, axes))
    applied = np.empty(axes)
    for k in range(count):
        for s in range(substeps):
            for i in range(axes):
                if s == 0 or in_drive:
                    applied[i] = demand[k, i] - gain[i] * x[motors[i]] - damping[i] * x[velocity[i]]
                if s == 0:
                    position[k, i] = x[motors[i]]
                    torque[k, i] = applied[i]
            free = ad @ x + bd @ applied
            for _ in range(2):
                # Coulomb: the force that would stop the motor within the substep, within its limit.
                moved = free.copy()
                for i in range(axes):
                    if coulomb[i] > 0:
                        stop = inertia[i] * moved[velocity[i]] / h
                        f = min(max(stop, -coulomb[i]), coulomb[i])
                        moved -= bd[:, i] * f
            x = moved
    return position, torque


def simulate(
    plant: OraclePlant,
    demand: Array,
    rate: float,
    *,
    gain: Array,
    damping: Array,
    in_drive: bool = True,
    substeps: int = 8,
) -> tuple[Array, Array]:
    """Motor positions and torques (n, M), noise-free, at the sample instants; torque held a sample."""
    mass, damp, stiff, motors = plant.matrices
    n, m = mass.shape[0], len(motors)
    inverse = np.linalg.inv(mass)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiff, -inverse @ damp]])
    b = np.zeros((2 * n, m))
    b[n:] = inverse[:, motors]
    if not in_drive and not any(plant.coulomb):
        substeps = 1
    h = 1.0 / rate / substeps
    block = expm(np.block([[a, b], [np.zeros((m, 2 * n + m))]]) * h)
    coulomb = np.array(plant.coulomb or [0.0] * m, dtype=float)
    rows = np.array(motors)
    inertia = np.array([mass[r, r] for r in motors])
    return _loop(  # type: ignore[no-any-return]
        np.ascontiguousarray(block[: 2 * n, : 2 * n]),
        np.ascontiguousarray(block[: 2 * n, 2 * n :]),
        rows,
        rows + n,
        np.ascontiguousarray(demand),
        np.asarray(gain, float),
        np.asarray(damping, float),
        in_drive,
        coulomb,
        inertia,
        h,
        substeps,
        np.zeros(2 * n),
    )


def multisine(
    rng: np.random.Generator, period: int, rate: float, band: tuple[float, float], *, odd: bool = True
) -> tuple[Array, Array]:
    """One period, peak 1, amplitude ∝ f^−½, the best of 8 random phases; and its lines [Hz]."""
    lines = np.arange(1, period // 2, 2 if odd else 1)
    hz = lines * rate / period
    hz = hz[(hz >= band[0]) & (hz <= band[1])]
    t = np.arange(period) / rate
    basis = np.exp(2j * np.pi * hz[:, None] * t) * hz[:, None] ** -0.5
    best = np.zeros(0)
    for _ in range(8):
        wave = (np.exp(1j * rng.uniform(0, 2 * np.pi, hz.size)) @ basis).real
        if best.size == 0 or np.abs(wave).max() / wave.std() < np.abs(best).max() / best.std():
            best = wave
    return best / np.abs(best).max(), hz
