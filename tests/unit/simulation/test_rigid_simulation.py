"""Rigid models in time against integrators that share no code with them."""

import numpy as np
from large_motion import effect, experiment, model, recording
from scipy.integrate import solve_ivp

from invid.simulation.run import simulate


def test_a_hardening_oscillator_follows_an_adaptive_integrator():
    time = np.arange(4000) / 400.0
    force = 2.0 * np.sin(2 * np.pi * 2.0 * time) + np.sin(2 * np.pi * 5.1 * time + 1.0)

    def slope(t: float, x: np.ndarray) -> list[float]:
        drive = 2.0 * np.sin(2 * np.pi * 2.0 * t) + np.sin(2 * np.pi * 5.1 * t + 1.0)
        pull = 500.0 * x[0] + 300.0 * x[0] ** 2 + 9e4 * x[0] ** 3 + 0.8 * x[1] + 0.3
        return [x[1], (drive - pull) / 0.4]

    truth = solve_ivp(slope, (0, time[-1]), [0.01, -0.2], t_eval=time, rtol=1e-9, atol=1e-12).y[0]
    effects = [
        effect("quadratic_stiffness", coefficient=300.0),
        effect("cubic_stiffness", coefficient=9e4),
        effect("viscous_friction", coefficient=0.8),
        effect("torque_offset", torque=0.3),
    ]
    data = recording(experiment(time, truth[:, None], force[:, None]))
    answer = simulate(model([0.4], effects, ground=np.array([500.0])), data)
    miss = answer.experiments[0].position[:, 0] - truth
    assert np.std(miss) < 2e-3 * np.std(truth)


def test_two_links_with_gravity_and_inertia_that_varies_follow_an_adaptive_integrator():
    b, g1, g2, m1, m2, m12 = 0.05, 3.0, 1.2, 0.25, 0.06, 0.06
    time = np.arange(1500) / 500.0

    def drive(t: float) -> np.ndarray:
        return np.array([1.5 * np.sin(3.0 * t), 0.4 * np.cos(5.0 * t)])

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        q, v = x[:2], x[2:]
        c, s = np.cos(q[1]), np.sin(q[1])
        inertia = np.array([[m1 + 2 * b * c, m12 + b * c], [m12 + b * c, m2]])
        forces = drive(t) - 0.3 * v
        forces[0] += b * s * (2 * v[0] * v[1] + v[1] ** 2) - g1 * np.sin(q[0]) - g2 * np.sin(q[0] + q[1])
        forces[1] -= b * s * v[0] ** 2 + g2 * np.sin(q[0] + q[1])
        return np.concatenate([v, np.linalg.solve(inertia, forces)])

    truth = solve_ivp(slope, (0, time[-1]), [0.3, -0.2, 0, 0], t_eval=time, rtol=1e-9, atol=1e-11).y[:2].T
    angle = {"cosine": {"value": b}, "sine": {"value": 0.0}}
    effects = [
        effect("gravity", torque=g1, angle=0.0),
        effect("gravity", "A2", other="A1", torque=g2, angle=0.0),
        effect("viscous_friction", coefficient=0.3),
        effect("viscous_friction", "A2", coefficient=0.3),
    ]
    coupling = np.array([[0.0, m12], [m12, 0.0]])
    right = model([m1, m2], effects, coupling, fit={"inertia_with_angle": angle})
    data = recording(experiment(time, truth, np.array([drive(t) for t in time])))
    miss = simulate(right, data).experiments[0].position - truth
    assert np.std(miss) < 0.01 * np.std(truth)
    lighter = model([m1, m2], effects[:1] + effects[2:], coupling, fit={"inertia_with_angle": angle})
    assert np.std(simulate(lighter, data).experiments[0].position - truth) > 0.1 * np.std(truth)
