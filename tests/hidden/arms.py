"""Rigid serial arms in production moves: three to seven axes, friction, gravity, no period, 1 kHz.

``draw(seed)`` gives a recording and the friction and motor inertias it was made from. Torque is Newton and
Euler's recursion (Luh, Walker, Paul 1980) along the motion, written here; friction is a hyperbolic tangent of
the velocity. Nothing in it is elastic, and the inertia and weight that an axis feels depend on the pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.recording.model import Experiment, Kind, Recording, Role

RATE = 1000.0


@dataclass(frozen=True, eq=False)
class Arm:
    """Links by Denavit and Hartenberg, (N,) each; centres of mass and inertias about them (N, 3)."""

    length: np.ndarray
    offset: np.ndarray
    twist: np.ndarray
    mass: np.ndarray
    centre: np.ndarray
    inertia: np.ndarray
    motor: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray


def draw(seed: int, axes: int | None = None, *, seconds: float | None = None) -> tuple[Recording, Arm]:
    """A recording of an arm and the arm."""
    rng = np.random.default_rng([seed, 11])
    count = axes or int(rng.integers(3, 8))
    arm = _arm(rng, count)
    time = np.arange(round((seconds or float(rng.uniform(15, 25))) * RATE)) / RATE
    position = np.stack([_moves(rng, time.size, float(rng.uniform(0.8, 1.8))) for _ in range(count)], axis=1)
    velocity = np.gradient(position, 1 / RATE, axis=0)
    acceleration = np.gradient(velocity, 1 / RATE, axis=0)
    torque = inverse_dynamics(arm, position, velocity, acceleration)
    torque += arm.motor * acceleration + arm.viscous * velocity + arm.coulomb * np.tanh(velocity / 0.01)
    size = torque.std(axis=0)
    resolution = 2 * np.pi / 2**20
    reading = np.round(position / resolution + rng.standard_normal(position.shape) / 3) * resolution
    measured = torque + float(rng.choice([0.002, 0.01])) * size * rng.standard_normal(torque.shape)
    experiment = Experiment(
        key="000",
        kind=Kind.OTHER,
        excited_axis=-1,
        role=Role.IDENTIFY,
        hold_gain=np.full(count, np.nan),
        period_samples=0,
        frequencies_hz=np.zeros(0),
        sample_rate_hz=RATE,
        time=time,
        position=reading,
        torque=measured,
    )
    return Recording(
        created="2026-01-01T00:00:00+00:00",
        robot="arm",
        axes=tuple(f"J{i + 1}" for i in range(count)),
        position_unit="rad",
        torque_unit="N·m",
        rated_torque=None,
        encoder_resolution=np.full(count, resolution),
        experiments=(experiment,),
    ), arm


def _arm(rng: np.random.Generator, count: int) -> Arm:
    mass = np.sort(rng.uniform(0.8, 6.0, count))[::-1]
    reach = rng.uniform(0.1, 0.4, count)
    size = mass * reach * 3.0
    return Arm(
        length=reach * rng.integers(0, 2, count),
        offset=reach * rng.integers(0, 2, count),
        twist=rng.choice([-np.pi / 2, 0.0, np.pi / 2], count),
        mass=mass,
        centre=rng.uniform(-0.5, 0.5, (count, 3)) * reach[:, None],
        inertia=(mass * reach**2)[:, None] * rng.uniform(0.05, 0.2, (count, 3)),
        motor=rng.uniform(0.05, 0.5) * size,
        coulomb=rng.uniform(0.2, 1.5, count) * size,
        viscous=rng.uniform(0.1, 1.0, count) * size,
    )


def _moves(rng: np.random.Generator, samples: int, reach: float) -> np.ndarray:
    """Point to point, fifth-order in time, with short rests."""
    out, at = np.zeros(samples), 0.0
    k = int(rng.uniform(0.0, 0.5) * RATE)
    while k < samples:
        goal = float(rng.uniform(-reach, reach))
        long = max(int(rng.uniform(0.5, 1.2) * RATE * np.sqrt(abs(goal - at))), 100)
        s = np.arange(long) / long
        part = at + (goal - at) * s**3 * (10 - 15 * s + 6 * s**2)
        out[k : k + long] = part[: samples - k]
        k += long
        out[k:], at = goal, goal
        k += int(rng.uniform(0.0, 0.4) * RATE)
    return out


def inverse_dynamics(arm: Arm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(n, N) torque of the joints without motors and friction."""
    samples, count = q.shape
    turns, spin = [], np.array([0.0, 0.0, 1.0])
    omega, alpha = np.zeros((samples, 3)), np.zeros((samples, 3))
    linear = np.tile([0.0, 0.0, 9.81], (samples, 1))
    forces, moments, arms = [], [], []
    for i in range(count):
        c, s = np.cos(q[:, i]), np.sin(q[:, i])
        ct, st = np.cos(arm.twist[i]), np.sin(arm.twist[i])
        zero, one = np.zeros(samples), np.ones(samples)
        turn = np.stack(
            [
                np.stack([c, -s * ct, s * st], -1),
                np.stack([s, c * ct, -c * st], -1),
                np.stack([zero, st * one, ct * one], -1),
            ],
            -2,
        )
        back = np.swapaxes(turn, 1, 2)
        to = np.array([arm.length[i], arm.offset[i] * st, arm.offset[i] * ct])
        alpha = _by(back, alpha + np.cross(omega, v[:, i, None] * spin) + a[:, i, None] * spin)
        omega = _by(back, omega + v[:, i, None] * spin)
        linear = _by(back, linear) + np.cross(alpha, to) + np.cross(omega, np.cross(omega, to))
        centre = arm.centre[i]
        at_centre = linear + np.cross(alpha, centre) + np.cross(omega, np.cross(omega, centre))
        forces.append(arm.mass[i] * at_centre)
        moments.append(arm.inertia[i] * alpha + np.cross(omega, arm.inertia[i] * omega))
        arms.append(np.broadcast_to(to, (samples, 3)))
        turns.append(turn)
    torque = np.zeros((samples, count))
    force, moment = np.zeros((samples, 3)), np.zeros((samples, 3))
    for i in reversed(range(count)):
        if i < count - 1:
            force, moment = _by(turns[i + 1], force), _by(turns[i + 1], moment)
        moment = moment + np.cross(arms[i], force) + np.cross(arms[i] + arm.centre[i], forces[i]) + moments[i]
        force = force + forces[i]
        torque[:, i] = np.einsum("nj,nj->n", moment, _by(np.swapaxes(turns[i], 1, 2), spin))
    return torque


def _by(turn: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return np.einsum("nij,...j->ni" if vector.ndim == 1 else "nij,nj->ni", turn, vector)
