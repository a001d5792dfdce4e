"""Plants of the hidden tests and their own linear algebra (full matrices, dense solves)."""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from invid.model.chains import CoupledChains


@dataclass(frozen=True, eq=False)
class Plant:
    """Full matrices; ``motors`` and ``ends`` are coordinate numbers; ``springs`` pairs of them."""

    chains: CoupledChains
    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    motors: np.ndarray
    ends: np.ndarray
    linear: bool = False

    @property
    def count(self) -> int:
        return self.motors.size

    def dof(self, axis: int, mass: int) -> int:
        """Coordinate of ``mass`` (from 1) on ``axis``."""
        return int(self.motors[axis]) + mass - 1

    def motion(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Condensed stiffness Z (F, M, M) and motion per motor motion W (F, dofs, M), for omega > 0."""
        full = (
            self.stiffness[None]
            + 1j * omega[:, None, None] * self.damping
            - omega[:, None, None] ** 2 * self.mass
        )
        inner = np.setdiff1d(np.arange(self.mass.shape[0]), self.motors)
        w = np.zeros((omega.size, self.mass.shape[0], self.count), dtype=complex)
        w[:, self.motors, np.arange(self.count)] = 1.0
        if inner.size:
            w[:, inner] = -np.linalg.solve(full[:, inner][:, :, inner], full[:, inner][:, :, self.motors])
        return full[:, self.motors] @ w, w


def assemble(chains: CoupledChains, *, linear: bool = False) -> Plant:
    """Matrices from the parameters alone."""
    sizes = [len(m) for m in chains.masses]
    starts = np.concatenate(([0], np.cumsum(sizes)[:-1])).astype(int)
    ends = (np.cumsum(sizes) - 1).astype(int)
    mass = np.diag(np.concatenate(chains.masses)).astype(float)
    mass[np.ix_(ends, ends)] += chains.couplings
    damping, stiffness = np.zeros_like(mass), np.zeros_like(mass)
    for start, k, d in zip(starts, chains.springs, chains.dampers, strict=True):
        for s in range(len(k)):
            at = np.ix_([start + s, start + s + 1], [start + s, start + s + 1])
            stiffness[at] += k[s] * np.array([[1, -1], [-1, 1]])
            damping[at] += d[s] * np.array([[1, -1], [-1, 1]])
    return Plant(chains, mass, damping, stiffness, starts, ends, linear)


def flexible_modes(plant: Plant) -> np.ndarray:
    """Free natural frequencies that are not rigid [rad/s]."""
    values = scipy.linalg.eigh(plant.stiffness, plant.mass, eigvals_only=True)
    return np.sqrt(np.abs(values[values > 1e-6 * values[-1]]))


def _dampers(masses: list[np.ndarray], springs: list[np.ndarray], ratio: np.ndarray) -> list[np.ndarray]:
    out, at = [], 0
    for m, k in zip(masses, springs, strict=True):
        reduced = m[:-1] * m[1:] / (m[:-1] + m[1:])
        out.append(2 * ratio[at : at + k.size] * np.sqrt(k * reduced))
        at += k.size
    return out


def paper_plant(rng: np.random.Generator, axes: tuple[str, ...] = ("A1", "A2", "A3")) -> Plant:
    """Section 4 of the paper with about one per cent of modal damping."""
    masses = [np.array([0.7, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]), np.array([7.0, 8.0, 9.0])]
    springs = [np.array([1000.0, 2000.0]), np.array([3000.0, 4000.0]), np.array([5000.0, 6000.0])]
    couplings = np.array([[0, 1.0, 2.0], [1.0, 0, 3.0], [2.0, 3.0, 0]])
    ratio = rng.uniform(0.005, 0.02, 6)
    return assemble(
        CoupledChains.build(masses, springs, _dampers(masses, springs, ratio), couplings, axes=axes)
    )


def random_plant(
    rng: np.random.Generator, axes: tuple[str, ...], sizes: tuple[int, ...], *, linear: bool = False
) -> Plant:
    """Random chains whose modes lie between about 2 and 14 Hz, not closer than 4 % to one another."""
    count = len(sizes)
    scale = float(np.exp(rng.uniform(np.log(0.3), np.log(20.0))))
    while True:
        masses = [scale * rng.uniform(0.5, 4.0, n) for n in sizes]
        springs = [
            np.array(
                [
                    (2 * np.pi * rng.uniform(3.0, 8.0)) ** 2 * (m[s] * m[s + 1]) / (m[s] + m[s + 1])
                    for s in range(m.size - 1)
                ]
            )
            for m in masses
        ]
        couplings = np.zeros((count, count))
        ends = [m[-1] for m in masses]
        for i in range(count):
            for j in range(i + 1, count):
                couplings[i, j] = couplings[j, i] = rng.uniform(-0.4, 0.4) * np.sqrt(ends[i] * ends[j])
        if np.linalg.eigvalsh(np.diag(ends) + couplings)[0] < 0.15 * min(ends):
            continue
        ratio = rng.uniform(0.005, 0.02, sum(sizes) - count)
        plant = assemble(
            CoupledChains.build(masses, springs, _dampers(masses, springs, ratio), couplings, axes=axes),
            linear=linear,
        )
        modes = np.sort(flexible_modes(plant)) / (2 * np.pi)
        if modes[0] < 1.8 or modes[-1] > 14.0 or (np.diff(np.log(modes)) < 0.04).any():
            continue
        return plant
