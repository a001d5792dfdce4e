"""Rigid models, and an axis of one mass that moves far, integrated here by code of its own."""

from collections.abc import Callable

import numpy as np

from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, EffectTerm, Estimate, Model
from invid.numerics.arrays import frozen_float
from invid.recording import Experiment, Kind, Recording, Role

RATE, SUB = 500.0, 10
Force = Callable[[float, float, float], float]


def moves(seconds: float, rng: np.random.Generator, stroke: float = 1.0) -> np.ndarray:
    """Point-to-point moves with quintic profiles of several speeds, dwells between them."""
    step = 1 / (RATE * SUB)
    pieces = [np.zeros(int(0.1 / step))]
    while sum(p.size for p in pieces) * step < seconds:
        start, goal = pieces[-1][-1], stroke * rng.uniform(-1, 1)
        s = np.linspace(0, 1, int(rng.uniform(0.3, 1.2) / step))
        pieces.append(start + (goal - start) * (10 * s**3 - 15 * s**4 + 6 * s**5))
        pieces.append(np.full(int(0.05 / step), goal))
    return np.concatenate(pieces)[: int(seconds / step)]


def simulate(
    rng: np.random.Generator,
    *,
    mass: float = 0.5,
    dry: tuple[float, float] = (0.0, 0.0),
    wet: tuple[float, float] = (0.0, 0.0),
    extra: Force = lambda q, v, t: 0.0,
    noise: float = 0.02,
    seconds: float = 20.0,
    stroke: float = 1.0,
) -> Experiment:
    """A mass under a PD loop; Coulomb friction sticks (Karnopp, semi-implicit), 2^17 counts a turn."""
    dt = 1 / (RATE * SUB)
    reference = moves(seconds, rng, stroke)
    speed = np.gradient(reference, dt)
    q = v = 0.0
    rows = []
    command = 0.0
    for k in range(reference.size):
        t = k * dt
        if k % SUB == 0:
            command = 400.0 * (reference[k] - q) + 20.0 * (speed[k] - v)
            rows.append((t, q, command))
        free = v + dt * (command - extra(q, v, t) - (wet[0] if v > 0 else wet[1]) * v) / mass
        grip = dt * (dry[0] if free > 0 else dry[1]) / mass
        v = 0.0 if abs(free) <= grip else free - np.sign(free) * grip
        q += dt * v
    time, position, torque = np.array(rows).T
    count = 2 * np.pi / 2**17
    position = np.round(position / count) * count
    torque = torque + noise * rng.standard_normal(torque.size)
    return experiment(time, position[:, None], torque[:, None])


def experiment(time, position, torque, kind=Kind.OTHER, key="000", role=Role.IDENTIFY, attributes=None):
    axes = position.shape[1]
    return Experiment(
        key=key,
        kind=kind,
        role=role,
        excited_axis=0,
        hold_gain=frozen_float(np.zeros(axes)),
        period_samples=0,
        frequencies_hz=frozen_float([]),
        sample_rate_hz=1.0 / float(np.median(np.diff(time))),
        time=frozen_float(time),
        position=frozen_float(position),
        torque=frozen_float(torque),
        attributes=attributes or {},
    )


def recording(*experiments: Experiment) -> Recording:
    axes = experiments[0].position.shape[1]
    return Recording(
        robot="test",
        axes=tuple(f"A{i + 1}" for i in range(axes)),
        position_unit="rad",
        torque_unit="N·m",
        created="2026-01-01T00:00:00Z",
        experiments=experiments,
    )


def effect(cause: str, axis: str = "A1", *, other: str | None = None, **values: float) -> EffectTerm:
    return EffectTerm(cause, axis, {k: Estimate(v) for k, v in values.items()}, "mass 1", other)


def model(masses, effects=(), coupling=None, ground=None, fit=None) -> Model:
    chains = CoupledChains.build(
        [[m] for m in masses], [[] for _ in masses], None, coupling, ground_springs=ground,
        axes=tuple(f"A{i + 1}" for i in range(len(masses))),
    )  # fmt: skip
    return Model(
        "test", "trajectory", chains, ChainStd.unknown(chains), effects=tuple(effects), fit=fit or {}
    )
