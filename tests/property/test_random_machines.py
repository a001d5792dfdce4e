"""Rigid machines drawn at random, six decades of inertia: what is named is what was put in, in any units."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numba
import numpy as np
import pytest

from invid.diagnosis.rigid import diagnose_trajectory
from invid.model.diagnosis_document import Diagnosis, Verdict
from invid.numerics.arrays import frozen_float
from invid.recording import Experiment, Kind, Recording, Role
from invid.rigid_motion.record_kind import is_trajectory


@dataclass(frozen=True)
class Force:
    """Sizes relative to the inertial torque and the speed of the motion."""

    up: float = 0.0
    down: float = 0.0
    wet_up: float = 0.0
    wet_down: float = 0.0
    static: float = 0.0
    gravity: float = 0.0
    offset: float = 0.0
    ripple: float = 0.0
    hum: float = 0.0


@numba.njit
def follow(
    reference, speed, sub, dt, mass, kp, kd, up, down, wu, wd, static, vs, gravity, offset, ripple, hum
):
    """A mass under a sampled PD loop; dry friction sticks; rows (position, torque) at the samples."""
    count = reference.size // sub
    out = np.zeros((count, 2))
    q, v, command = 0.0, 0.0, 0.0
    for k in range(count * sub):
        if k % sub == 0:
            command = kp * (reference[k] - q) + kd * (speed[k] - v)
            out[k // sub] = q, command
        pull = gravity * np.sin(q + 0.4) + offset + ripple * np.sin(31.0 * q)
        pull += hum * np.sin(2 * np.pi * 3.1 * k * dt) + (wu if v > 0 else wd) * v
        free = v + dt * (command - pull) / mass
        grip = dt * ((up if free > 0 else down) + static * np.exp(-((v / vs) ** 2))) / mass
        v = 0.0 if abs(free) <= grip else free - np.sign(free) * grip
        q += dt * v
    return out


def machine(seed: int, force: Callable[[float], Force]) -> Recording:
    """Moves of random stroke, speed and dwell; inertia, loop, sample rate, encoder, noise and sizes drawn."""
    rng = np.random.default_rng(seed)
    rate = float(rng.choice([200, 500, 1000, 2000]))
    sub = max(2, int(8000 / rate))
    dt, seconds = 1 / rate / sub, float(rng.uniform(6, 30))
    stroke = float(np.exp(rng.uniform(np.log(0.3), np.log(6))))
    pieces = [np.zeros(int(0.2 / dt))]
    while sum(p.size for p in pieces) * dt < seconds:
        start, goal = pieces[-1][-1], stroke * rng.uniform(-1, 1)
        s = np.linspace(0, 1, int(rng.uniform(0.25, 2.0) / dt))
        pieces.append(start + (goal - start) * (10 * s**3 - 15 * s**4 + 6 * s**5))
        pieces.append(np.full(int(rng.uniform(0, 0.3) / dt) + 1, goal))
    reference = np.concatenate(pieces)[: int(seconds / dt)]
    speed = np.gradient(reference, dt)
    mass = float(np.exp(rng.uniform(np.log(1e-3), np.log(1e3))))
    torque = mass * float(np.sqrt(np.mean(np.gradient(speed, dt) ** 2)))
    fast = float(np.sqrt(np.mean(speed**2)))
    own = 2 * np.pi * rng.uniform(3, min(15, rate / 20))
    f = force(float(np.exp(rng.uniform(np.log(0.1), np.log(1.5)))))
    rows = follow(
        reference, speed, sub, dt, mass, mass * own**2, 1.4 * mass * own, f.up * torque, f.down * torque,
        f.wet_up * torque / fast, f.wet_down * torque / fast, f.static * torque, 0.25 * fast,
        f.gravity * torque, f.offset * torque, f.ripple * torque, f.hum * torque,
    )  # fmt: skip
    count = 2 * np.pi / 2 ** int(rng.integers(13, 21))
    noise = float(np.exp(rng.uniform(np.log(1e-3), np.log(0.1)))) * torque
    position = np.round(rows[:, :1] / count) * count
    measured = rows[:, 1:] + noise * rng.standard_normal((rows.shape[0], 1))
    return recorded(np.arange(rows.shape[0]) / rate, position, measured)


def recorded(time: np.ndarray, position: np.ndarray, torque: np.ndarray) -> Recording:
    one = Experiment(
        key="000", kind=Kind.OTHER, role=Role.IDENTIFY, excited_axis=0, hold_gain=frozen_float([0.0]),
        period_samples=0, frequencies_hz=frozen_float([]), sample_rate_hz=1 / float(time[1] - time[0]),
        time=frozen_float(time), position=frozen_float(position), torque=frozen_float(torque),
    )  # fmt: skip
    return Recording(
        robot="drawn", axes=("A1",), position_unit="rad", torque_unit="N·m",
        created="2026-01-01T00:00:00Z", experiments=(one,),
    )  # fmt: skip


def causes(diagnosis: Diagnosis) -> set[str]:
    return {f.effect.cause for f in diagnosis.findings}


def both_ways(x: float) -> Force:
    return Force(1.4 * x, 0.7 * x, 0.5 * x, 0.9 * x)


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("seed", "force", "named"),
    [
        (11, lambda x: Force(), set()),
        (12, lambda x: Force(x, x, x, x), {"coulomb_friction", "viscous_friction"}),
        (105, both_ways, {"asymmetric_friction"}),
        (204, both_ways, {"asymmetric_friction"}),
        (13, lambda x: Force(x, x, static=0.7 * x), {"stribeck_friction"}),
        (107, lambda x: Force(x, x, gravity=2 * x), {"gravity", "coulomb_friction"}),
        (14, lambda x: Force(x, x, offset=x), {"coulomb_friction", "torque_offset"}),
    ],
    ids=["nothing", "dry and wet", "by direction", "by direction, another", "Stribeck", "gravity and dry",
         "dry and offset"],
)  # fmt: skip
def test_what_was_put_in_is_named_and_nothing_else(seed, force, named):
    data = machine(seed, force)
    assert is_trajectory(data)
    diagnosis = diagnose_trajectory(data)
    assert causes(diagnosis) == named, diagnosis.sentences


def test_a_ripple_over_position_is_cogging():
    diagnosis = diagnose_trajectory(machine(15, lambda x: Force(ripple=x)))
    (cogging,) = diagnosis.findings
    assert cogging.cause == "cogging"
    assert cogging.effect.value("cycles_per_rev") == pytest.approx(31.0, rel=2e-3)


def test_what_has_no_name_gets_none():
    diagnosis = diagnose_trajectory(machine(15, lambda x: Force(hum=x)))
    assert causes(diagnosis) == set()
    assert diagnosis.verdict is Verdict.UNEXPLAINED


def test_other_units_of_time_and_torque_change_no_verdict():
    data = machine(16, lambda x: Force(x, x, 0.5 * x, 0.5 * x))
    plain = diagnose_trajectory(data)
    e = data.experiments[0]
    slow, strong = 20.0, 3e4
    other = replace(
        e, time=frozen_float(slow * e.time), sample_rate_hz=e.sample_rate_hz / slow,
        torque=frozen_float(strong * e.torque),
    )  # fmt: skip
    scaled = diagnose_trajectory(replace(data, experiments=(other,)))
    assert scaled.verdict is plain.verdict
    assert causes(scaled) == causes(plain) == {"coulomb_friction", "viscous_friction"}
    coulomb = [
        next(f.effect.value("torque") for f in d.findings if f.effect.cause == "coulomb_friction")
        for d in (plain, scaled)
    ]
    assert coulomb[1] == pytest.approx(strong * coulomb[0], rel=1e-6)
    assert scaled.model.chains.masses[0][0] == pytest.approx(
        strong * slow**2 * plain.model.chains.masses[0][0], rel=1e-6
    )
