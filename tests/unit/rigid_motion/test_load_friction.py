"""Friction that grows with the load: its size, and telling it from Coulomb friction."""

import numpy as np
import pytest
from large_motion import experiment, moves, recording

from invid.diagnosis.rigid import diagnose_trajectory
from invid.model.diagnosis_document import Diagnosis

RATE, SUB = 500.0, 20


def loaded(rng: np.random.Generator, *, stroke: float, dry: float, grows: float) -> Diagnosis:
    """A pendulum of 3 N·m under a PD loop, 0.01 N·m torque noise; dry friction = dry + grows·|load|."""
    dt, mass, weight = 1 / RATE / SUB, 0.2, 3.0
    reference = np.repeat(moves(25.0, rng, stroke), SUB // 10)
    speed = np.gradient(reference, dt)
    q = v = command = 0.0
    rows = []
    for k in range(reference.size):
        if k % SUB == 0:
            command = 160.0 * (reference[k] - q) + 8.0 * (speed[k] - v)
            rows.append((k * dt, q, command))
        load = weight * np.sin(q + 0.5)
        level = dry + grows * abs(load)
        free = v + dt * (command - load) / mass
        v = 0.0 if abs(free) <= dt * level / mass else free - np.sign(free) * dt * level / mass
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
