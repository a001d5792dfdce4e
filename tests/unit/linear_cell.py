"""A linear cell by one matrix exponential: holds in the drive or the master, a slow torque channel.

Shares no code with the estimator (nor with ``benchmarks/shared/plant_oracle.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import block_diag, expm

from invid.model.document import Model, parameter_vector, stds_by_name
from invid.recording.model import Experiment, Kind, Recording, Role


def _chain(values: list[float]) -> np.ndarray:
    matrix = np.zeros((len(values) + 1, len(values) + 1))
    for q, value in enumerate(values):
        matrix[q : q + 2, q : q + 2] += value * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return matrix


@dataclass(frozen=True)
class LinearCell:
    """Chains of masses, springs and dampers; ``couplings`` {(i, j): inertia} between their ends, ``modes``
    {axis: (mass, spring, damper)} on them."""

    masses: list[list[float]]
    springs: list[list[float]]
    dampers: list[list[float]]
    couplings: dict[tuple[int, int], float] = field(default_factory=dict)
    modes: dict[int, tuple[float, float, float]] = field(default_factory=dict)

    @property
    def truth(self) -> dict[str, float]:
        """By the names of ``parameter_vector``."""
        out = {}
        for kind, parts in (("mass", self.masses), ("spring", self.springs), ("damper", self.dampers)):
            for i, values in enumerate(parts):
                out |= {f"A{i + 1}.{kind}.{q + 1}": v for q, v in enumerate(values)}
        count = len(self.masses)
        pairs = [(i, j) for i in range(count) for j in range(i + 1, count)]
        return out | {f"A{i + 1}-A{j + 1}.coupling": self.couplings.get((i, j), 0.0) for i, j in pairs}

    def run(
        self,
        command: np.ndarray,
        rate: float,
        *,
        gain: np.ndarray,
        damping: np.ndarray,
        in_drive: bool = True,
        time_constant: float = 0.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Positions and recorded torques (n, M); the command is held over the sample."""
        mass = np.diag([*np.concatenate(self.masses), *(m for m, _, _ in self.modes.values())])
        ends = np.cumsum([len(m) for m in self.masses]) - 1
        for (i, j), value in self.couplings.items():
            mass[ends[i], ends[j]] = mass[ends[j], ends[i]] = value
        motors = np.array([0, *(ends[:-1] + 1)])
        n, m = mass.shape[0], motors.size
        inputs = np.zeros((n, m))
        inputs[motors, range(m)] = 1.0
        inner = np.linalg.inv(mass)
        alone = [np.zeros((1, 1))] * len(self.modes)
        stiff = block_diag(*map(_chain, self.springs), *alone)
        damp = block_diag(*map(_chain, self.dampers), *alone)
        for number, (axis, (_, spring, damper)) in enumerate(self.modes.items()):
            apart = np.zeros(n)
            apart[ends[axis]], apart[ends[-1] + 1 + number] = 1.0, -1.0
            stiff, damp = stiff + spring * np.outer(apart, apart), damp + damper * np.outer(apart, apart)
        if in_drive:
            stiff, damp = stiff + inputs * gain @ inputs.T, damp + inputs * damping @ inputs.T
        # States: positions, velocities, what the torque channel shows of the torque.
        a = np.zeros((2 * n + m, 2 * n + m))
        b = np.zeros((2 * n + m, m))
        a[:n, n : 2 * n] = np.eye(n)
        a[n : 2 * n, :n], a[n : 2 * n, n : 2 * n] = -inner @ stiff, -inner @ damp
        b[n : 2 * n] = inner @ inputs
        if time_constant:
            a[2 * n :, 2 * n :] = -np.eye(m) / time_constant
            b[2 * n :] = np.eye(m) / time_constant
            if in_drive:
                a[2 * n :, :n] = -(inputs * gain).T / time_constant
                a[2 * n :, n : 2 * n] = -(inputs * damping).T / time_constant
        step = expm(np.block([[a, b], [np.zeros((m, 2 * n + 2 * m))]]) / rate)
        x = np.zeros(2 * n + m)
        position, torque = np.empty(command.shape), np.empty(command.shape)
        for k, asked in enumerate(command):
            hold = gain * x[motors] + damping * x[n + motors]
            position[k] = x[motors]
            torque[k] = x[2 * n :] if time_constant else asked - hold
            acting = asked if in_drive else asked - hold
            x = step[: 2 * n + m, : 2 * n + m] @ x + step[: 2 * n + m, 2 * n + m :] @ acting
        return position, torque


def multisine(
    rng: np.random.Generator, period: int, rate: float, top: float, stride: int = 1, first: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """One period of peak 1, amplitude ∝ f^−½ from 0.3 Hz on every ``stride``-th line, and its lines [Hz]."""
    hz = np.arange(1, period // 2) * rate / period
    hz = hz[(hz >= 0.3) & (hz <= top)][first::stride]
    basis = np.exp(2j * np.pi * hz[:, None] * np.arange(period) / rate) * hz[:, None] ** -0.5
    waves = [(np.exp(1j * rng.uniform(0, 2 * np.pi, hz.size)) @ basis).real for _ in range(8)]
    best = min(waves, key=lambda w: float(np.abs(w).max() / w.std()))
    return best / np.abs(best).max(), hz


def record(
    cell: LinearCell,
    *,
    seed: int,
    rate: float,
    gain: np.ndarray,
    damping: np.ndarray,
    said: np.ndarray,
    together: bool = True,
    interleaved: bool = False,
    in_drive: bool = True,
    time_constant: float = 0.0,
    period: int = 4000,
    demand_at_end: bool = False,
) -> Recording:
    """As many experiments as axes, two settled periods each, no axis named; hold gains are ``said``.

    ``demand_at_end``: torque and demand, the hold in both, are read at the end of the command's sample.
    """
    rng, count = np.random.default_rng(seed), len(cell.masses)
    experiments = []
    for number in range(count):
        wave = np.zeros((period, count))
        lines = np.zeros(0)
        for i in range(count):
            if together or i == number:
                share = (count, (i + number) % count) if interleaved else (1, 0)
                wave[:, i], hz = multisine(rng, period, rate, 13.0, *share)
                lines = hz if lines.size == 0 or not interleaved else np.union1d(lines, hz)
        command = np.tile(20.0 * wave, (4, 1))
        position, torque = cell.run(
            command,
            rate,
            gain=gain,
            damping=damping,
            in_drive=in_drive,
            time_constant=time_constant,
        )
        if demand_at_end:
            held = command if in_drive else torque
            torque = torque + np.roll(held, 1, axis=0) - held
        position, torque = position[2 * period :], torque[2 * period :]
        experiments.append(
            Experiment(
                f"{number:03d}",
                Kind.MULTISINE,
                Role.IDENTIFY,
                -1,
                said,
                period,
                lines,
                rate,
                np.arange(2 * period) / rate,
                position + 2e-6 * rng.standard_normal(position.shape),
                torque + 0.02 * rng.standard_normal(torque.shape),
                torque if demand_at_end else None,
            )
        )
    axes = tuple(f"A{i + 1}" for i in range(count))
    sizes = tuple(len(m) for m in cell.masses)
    return Recording(
        "foreign", axes, "rad", "N·m", "2026-11-21T00:00:00Z", tuple(experiments), masses_per_axis=sizes
    )


def deviations(model: Model, cell: LinearCell) -> dict[str, float]:
    """Errors in stated standard deviations by name."""
    std = stds_by_name(model)
    names, values = parameter_vector(model.chains)
    found = dict(zip(names, values, strict=True))
    return {name: (found[name] - value) / std[name] for name, value in cell.truth.items()}
