"""Two coupled chains with friction, free play and a hardening spring, by RK4: data for tests of the
likelihood.

Shares no code with ``invid``. The hold acts at every sub-step; torque is what acted last before a sample.
"""

from dataclasses import dataclass, field

import numpy as np
from numba import njit

from invid.recording.model import Experiment, Kind, Recording, Role

RATE, PERIOD, PERIODS = 500.0, 2048, 3


@njit(cache=True)
def _forces(q, v, tau, inverse, motors, pairs, springs, friction, out):
    out[:] = 0.0
    for s in range(pairs.shape[0]):
        a, b = pairs[s, 0], pairs[s, 1]
        d, half = q[a] - q[b], springs[s, 3]
        outside = max(d - half, 0.0) + min(d + half, 0.0)
        f = springs[s, 0] * outside + springs[s, 2] * d**3
        if outside != 0.0 or half == 0.0:
            f += springs[s, 1] * (v[a] - v[b])
        out[a] -= f
        out[b] += f
    for m in range(motors.size):
        speed = v[motors[m]]
        resists = friction[m, 1] + friction[m, 3] * abs(speed)
        out[motors[m]] += tau[m] - resists * speed - friction[m, 2]
        lead = friction[m, 4]
        if lead:  # a soft contact that holds the motor: it bears what would speed it up as well
            held = speed + lead * out[motors[m]] * inverse[motors[m], motors[m]]
            out[motors[m]] -= friction[m, 0] * min(max(held / 5e-3, -1.0), 1.0)
        else:
            out[motors[m]] -= friction[m, 0] * np.tanh(speed / 2e-3)


@njit(cache=True)
def _march(torque, hold, inverse, motors, pairs, springs, friction, step, sub):
    n = inverse.shape[0]
    q, v = np.zeros(n), np.zeros(n)
    count = torque.shape[0]
    position, acted = np.zeros((count, motors.size)), np.zeros((count, motors.size))
    tau = np.zeros(motors.size)
    h = step / sub
    f, kq, kv = np.zeros(n), np.zeros((4, n)), np.zeros((4, n))
    share = np.array([0.0, 0.5, 0.5, 1.0])
    for t in range(count):
        for m in range(motors.size):
            position[t, m] = q[motors[m]]
            acted[t, m] = tau[m]
        for _ in range(sub):
            for m in range(motors.size):
                tau[m] = torque[t, m] - hold[m] * q[motors[m]]
            for stage in range(4):
                back = kq[stage - 1] * (share[stage] * h) if stage else np.zeros(n)
                slow = kv[stage - 1] * (share[stage] * h) if stage else np.zeros(n)
                kq[stage] = v + slow
                _forces(q + back, v + slow, tau, inverse, motors, pairs, springs, friction, f)
                kv[stage] = inverse @ f
            q = q + h * (kq[0] + 2 * kq[1] + 2 * kq[2] + kq[3]) / 6
            v = v + h * (kv[0] + 2 * kv[1] + 2 * kv[2] + kv[3]) / 6
    return position, acted


@dataclass(frozen=True)
class ChainPlant:
    """Masses and springs of each chain, inertia between the loads; per spring a gap and a cubic part."""

    masses: tuple[tuple[float, ...], ...] = ((1.2, 2.1), (1.6, 1.1, 2.4))
    springs: tuple[tuple[float, ...], ...] = ((2600.0,), (4100.0, 2300.0))
    coupling: float = 0.5
    dry: tuple[float, ...] = (0.4, 0.6)
    viscous: tuple[float, ...] = (1.1, 2.0)
    offset: tuple[float, ...] = (0.0, 0.0)
    drag: tuple[float, ...] = (0.0, 0.0)
    lead: tuple[float, ...] = (0.0, 0.0)
    gaps: dict[int, float] = field(default_factory=dict)
    cubes: dict[int, float] = field(default_factory=dict)
    noise: float = 0.05

    @property
    def sizes(self) -> tuple[int, ...]:
        """Masses of each chain."""
        return tuple(len(m) for m in self.masses)

    def recording(self, seed: int, level: float = 6.0) -> Recording:
        """Each axis shaken by odd lines to 15 Hz at one level, and once at 0.6 of it for validation."""
        rng = np.random.default_rng(seed)
        experiments = []
        for axis in range(len(self.masses)):
            for role, share in ((Role.IDENTIFY, 1.0), (Role.VALIDATE, 0.6)):
                experiments.append(self._experiment(rng, axis, role, level * share))
        return Recording(
            "chains", ("A1", "A2"), "rad", "N·m", "2026-01-01T00:00:00Z",
            tuple(experiments), masses_per_axis=self.sizes, rated_torque=np.full(2, 50.0),
            encoder_resolution=np.full(2, 2 * np.pi / 2**19), source=f"seed {seed}",
        )  # fmt: skip

    def _experiment(self, rng, axis, role, level):
        first = np.cumsum([0] + [len(m) for m in self.masses])
        inertia = np.diag(np.concatenate(self.masses))
        ends = first[1:] - 1
        inertia[ends[0], ends[1]] = inertia[ends[1], ends[0]] = self.coupling
        pairs, springs = [], []
        for chain, (start, ks) in enumerate(zip(first, self.springs, strict=False)):
            for q, k in enumerate(ks):
                number = len(pairs)
                reduced = 1 / (1 / self.masses[chain][q] + 1 / self.masses[chain][q + 1])
                pairs.append((start + q, start + q + 1))
                damper = 0.02 * np.sqrt(k * reduced)
                springs.append((k, damper, self.cubes.get(number, 0.0), 0.5 * self.gaps.get(number, 0.0)))
        lines = np.arange(1, int(15.0 * PERIOD / RATE), 2)
        half = np.zeros(PERIOD // 2 + 1, complex)
        half[lines] = np.exp(2j * np.pi * rng.random(lines.size))
        wave = np.fft.irfft(half)
        excitation = np.zeros((PERIOD * PERIODS, 2))
        excitation[:, axis] = np.tile(wave * level / wave.std(), PERIODS)
        hold = np.where(np.arange(2) == axis, 40.0, 400.0)
        friction = np.stack((self.dry, self.viscous, self.offset, self.drag, self.lead), axis=1)
        position, torque = _march(
            excitation, hold, np.linalg.inv(inertia), first[:-1].astype(np.int64), np.array(pairs),
            np.array(springs), friction, 1 / RATE, 8,
        )  # fmt: skip
        count = 2 * np.pi / 2**19
        return Experiment(
            key=f"{axis}{role}", kind=Kind.MULTISINE, role=role, excited_axis=axis, hold_gain=hold,
            period_samples=PERIOD, frequencies_hz=lines * RATE / PERIOD, sample_rate_hz=RATE,
            time=np.arange(len(position)) / RATE, position=np.round(position / count) * count,
            torque=torque + self.noise * rng.standard_normal(torque.shape),
        )  # fmt: skip
