"""Friction that grows with the load: its size, and telling it from Coulomb friction."""

from __future__ import annotations

import numpy as np
import pytest
from large_motion import effect, experiment, model, moves, recording
from scipy.integrate import solve_ivp

from invid.diagnosis.rigid import diagnose_trajectory
from invid.model.diagnosis_document import Diagnosis
from invid.simulation.run import simulate

RATE, SUB = 500.0, 20


def loaded(
    rng: np.random.Generator, *, stroke: float, dry: float, grows: float, inertia: bool = False
) -> Diagnosis:
    """A pendulum of 3 N·m under a PD loop, 0.01 N·m torque noise; dry friction = dry + grows·|load|."""
    dt, mass, weight = 1 / RATE / SUB, 0.2, 3.0
    reference = np.repeat(moves(25.0, rng, stroke), SUB // 10)
    speed = np.gradient(reference, dt)
    q = v = command = accelerated = 0.0
    rows = []
    for k in range(reference.size):
        if k % SUB == 0:
            command = 160.0 * (reference[k] - q) + 8.0 * (speed[k] - v)
            rows.append((k * dt, q, command))
        load = weight * np.sin(q + 0.5)
        level = dry + grows * abs(load + (mass * accelerated if inertia else 0.0))
        free = v + dt * (command - load) / mass
        stopped = 0.0 if abs(free) <= dt * level / mass else free - np.sign(free) * dt * level / mass
        accelerated, v = (stopped - v) / dt, stopped
        q += dt * v
    time, position, torque = np.array(rows).T
    torque = torque + 0.01 * rng.standard_normal(torque.size)
    return diagnose_trajectory(recording(experiment(time, position[:, None], torque[:, None])))


def test_friction_that_grows_with_the_weight_is_named_with_its_size_beside_gravity():
    diagnosis = loaded(np.random.default_rng(1), stroke=1.5, dry=0.0, grows=0.25)
    found = {f.effect.cause: f for f in diagnosis.findings}
    assert set(found) == {"gravity", "load_dependent_friction"}, diagnosis.sentences
    named = found["load_dependent_friction"]
    assert named.effect.value("coefficient") == pytest.approx(0.25, rel=0.05)
    assert named.effect.value("inertia_counts") == 0.0
    assert named.after < named.before


def test_under_a_weight_that_hardly_varies_it_is_coulomb_friction_and_the_diagnosis_says_so():
    # Around level (1.07 + 0.5 is a quarter turn) the weight varies by less than a twentieth.
    rng = np.random.default_rng(5)
    dt, mass = 1 / RATE / SUB, 0.2
    reference = 1.07 + np.repeat(moves(20.0, rng, 0.3), SUB // 10)
    speed = np.gradient(reference, dt)
    q, v, command, rows = float(reference[0]), 0.0, 0.0, []
    for k in range(reference.size):
        if k % SUB == 0:
            command = 160.0 * (reference[k] - q) + 8.0 * (speed[k] - v)
            rows.append((k * dt, q, command))
        load = 3.0 * np.sin(q + 0.5)
        free, grip = v + dt * (command - load) / mass, dt * 0.25 * abs(load) / mass
        v = 0.0 if abs(free) <= grip else free - np.sign(free) * grip
        q += dt * v
    time, position, torque = np.array(rows).T
    torque = torque + 0.01 * rng.standard_normal(torque.size)
    diagnosis = diagnose_trajectory(recording(experiment(time, position[:, None], torque[:, None])))
    found = {f.effect.cause: f.effect for f in diagnosis.findings}
    assert "load_dependent_friction" not in found
    assert found["coulomb_friction"].value("torque") == pytest.approx(0.75, rel=0.05)
    assert any("depends on the load" in text for text in diagnosis.details["not_shown"])


@pytest.mark.parametrize("inertia", [0.0, 1.0], ids=["weight", "weight and inertia"])
def test_a_model_with_it_moves_as_an_adaptive_integrator_says(inertia):
    time = np.arange(1500) / 500.0
    mass, weight, grows = 0.4, 3.0, 0.3

    def drive(t: float) -> float:
        return float(2.5 * np.sin(3.0 * t))

    def slope(t: float, x: np.ndarray) -> list[float]:
        load = weight * np.sin(x[0])
        way = float(np.tanh(2e3 * x[1]))
        # Solved for the acceleration: the load under way is m·a + w, of one sign or the other.
        a = (drive(t) - load - grows * way * abs(load)) / mass
        if inertia:
            for sign in (1.0, -1.0):
                a = (drive(t) / (1 + sign * grows * way) - load) / mass
                if sign * (mass * a + load) >= 0:
                    break
        return [x[1], a]

    truth = solve_ivp(
        slope, (0, time[-1]), [0.3, 0.5], t_eval=time, rtol=1e-7, atol=1e-9, method="LSODA", max_step=2e-3
    ).y[0]
    terms = [
        effect("gravity", torque=weight, angle=0.0),
        effect("load_dependent_friction", coefficient=grows, inertia_counts=inertia),
    ]
    data = recording(experiment(time, truth[:, None], np.array([[drive(t)] for t in time])))
    miss = simulate(model([mass], terms), data).experiments[0].position[:, 0] - truth
    without = simulate(model([mass], terms[:1]), data).experiments[0].position[:, 0] - truth
    assert np.std(miss) < 0.02 * np.std(truth)
    assert np.std(without) > 5 * np.std(miss)
