"""The simulated plant against scipy's solve_ivp and against closed forms."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from invid.model.chains import CoupledChains, case_study
from invid_drivers.simulated import kernel
from invid_drivers.simulated.config import AxisSimulation, EffectConfig
from invid_drivers.simulated.plant import Plant
from invid_drivers.simulated.structure import CAUSES, build_structure

H = 0.00025


def axes(count: int, **keys: Any) -> list[AxisSimulation]:
    return [AxisSimulation.model_validate(keys)] * count


def plant(chains: CoupledChains, *effects: dict[str, Any], **keys: Any) -> Plant:
    made = build_structure(
        chains, axes(chains.branches, **keys), [EffectConfig.model_validate(e) for e in effects]
    )
    return Plant(made, H)


def run(made: Plant, torque: Any, seconds: float) -> np.ndarray:
    """Positions at every millisecond under motor torques torque(t), held for a millisecond."""
    made.command[:, kernel.MODE] = kernel.MODE_TORQUE
    rows = []
    for k in range(round(seconds * 1000)):
        made.command[:, kernel.TORQUE] = torque(k * 0.001)
        made.advance_to((k + 1) * 1_000_000)
        rows.append(made.positions.copy())
    return np.array(rows)


def reference(
    chains: CoupledChains, torque: Any, seconds: float, force: Any = lambda t, q, v: 0.0
) -> np.ndarray:
    """The same by solve_ivp, millisecond by millisecond; ``force`` acts on all coordinates."""
    inverse = np.linalg.inv(chains.mass_matrix)
    k, c, motors = chains.stiffness_matrix, chains.damping_matrix, chains.motor_dofs
    n = chains.dofs
    state = np.zeros(2 * n)
    rows = []
    for step in range(round(seconds * 1000)):
        held = np.zeros(n)
        held[motors] = torque(step * 0.001)

        def slope(t: float, x: np.ndarray, held: np.ndarray = held) -> np.ndarray:
            q, v = x[:n], x[n:]
            return np.concatenate((v, inverse @ (held - k @ q - c @ v + force(t, q, v))))

        span = (step * 0.001, (step + 1) * 0.001)
        state = solve_ivp(slope, span, state, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        rows.append(state[:n].copy())
    return np.array(rows)


def excitation(t: float) -> np.ndarray:
    return np.array([20.0, 30.0, 40.0]) * np.cos(2 * np.pi * np.array([5.0, 3.1, 7.3]) * t)


def one_axis(k: float = 1000.0, d: float = 0.5) -> CoupledChains:
    return CoupledChains.build([[1.0, 2.0]], [[k]], [[d]])


def push(t: float) -> float:
    return 20.0 * math.cos(2 * math.pi * 4.0 * t)


def test_the_linear_case_study_agrees_with_solve_ivp_to_ten_digits() -> None:
    chains = case_study(damping_ratio=0.01)
    ours = run(plant(chains), excitation, 0.3)
    theirs = reference(chains, excitation, 0.3)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10 * np.abs(theirs).max())


def smooth(theta: float, x: float, v: float, kind: str) -> tuple[float, float]:
    """Force on motor and load of the effects below, written out again."""
    if kind == "cubic":
        f = 2e6 * x**3
        return -f, f
    if kind == "gravity":
        return 0.0, -8.0 * math.sin(theta - x + 0.5)  # at the final mass
    if kind == "cogging":
        return -3.0 * math.sin(30.0 * theta + 0.2), 0.0
    if kind == "offset":
        return -2.0, 0.0
    if kind == "transmission":
        error = 0.002 * math.sin(20.0 * theta + 0.3)
        slope = 0.04 * math.cos(20.0 * theta + 0.3)
        return 1000.0 * (x - (x - error) * (1 - slope)), -1000.0 * error
    raise LookupError(kind)


@pytest.mark.parametrize(
    ("kind", "effect"),
    [
        ("cubic", {"cause": "cubic_stiffness", "parameters": {"coefficient": 2e6}}),
        ("gravity", {"cause": "gravity", "parameters": {"torque": 8.0, "angle": 0.5}}),
        ("cogging", {"cause": "cogging", "parameters": {"torque": 3.0, "cycles_per_rev": 30, "phase": 0.2}}),
        ("offset", {"cause": "torque_offset", "parameters": {"torque": 2.0}}),
        (
            "transmission",
            {
                "cause": "transmission_error",
                "parameters": {"amplitude": 0.002, "cycles_per_rev": 20, "phase": 0.3},
            },
        ),
    ],
)
def test_a_smooth_effect_agrees_with_solve_ivp(kind: str, effect: dict[str, Any]) -> None:
    chains = one_axis()

    def force(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.array(smooth(q[0], q[0] - q[1], v[0] - v[1], kind))

    theirs = reference(chains, push, 0.3, force)
    ours = run(plant(chains, {"axis": "A1", **effect}), push, 0.3)
    bare = reference(chains, push, 0.3)
    change = np.abs(theirs - bare).max()
    assert change > 1e-3 * np.abs(bare).max(), "the effect must be seen, or the test shows nothing"
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-3 * change)


def test_friction_never_adds_energy() -> None:
    made = plant(case_study(), friction={"coulomb_Nm": 5.0})
    made.state[:9] = np.linspace(-0.1, 0.1, 9)
    stiffness, _, mass = made.structure.matrices(0.0)
    energies = []
    for k in range(400):
        made.advance_to((k + 1) * 5_000_000)
        q, v = made.positions, made.velocities
        energies.append(0.5 * q @ stiffness @ q + 0.5 * v @ mass @ v)
    # a stuck mass yields by F·h²/12m within a sub-step, a compliance of 1e-8 rad/N·m that stores and
    # returns energy: nothing may build up beyond it
    lowest = np.minimum.accumulate(energies)
    assert np.all(np.array(energies) - lowest <= 1e-7 * energies[0])
    assert energies[-1] < 0.5 * energies[0]


def test_every_cause_of_the_contract_can_be_put_into_the_plant() -> None:
    parameters = {
        "coulomb_friction": {"torque": 1.0},
        "viscous_friction": {"coefficient": 1.0},
        "stribeck_friction": {"static": 2.0, "coulomb": 1.0, "velocity": 0.1},
        "presliding_friction": {"stiffness": 1e4, "torque": 1.0},
        "asymmetric_friction": {
            "coulomb_positive": 1.0,
            "coulomb_negative": 0.5,
            "viscous_positive": 1.0,
            "viscous_negative": 0.2,
        },
        "torque_offset": {"torque": 1.0},
        "cogging": {"torque": 1.0, "cycles_per_rev": 20, "phase": 0},
        "spring_damping": {"coefficient": 3.0},
        "cubic_stiffness": {"coefficient": 1e5},
        "backlash": {"gap": 0.005},
        "spring_hysteresis": {"stiffness": 500.0, "torque": 1.0},
        "transmission_error": {"amplitude": 0.001, "cycles_per_rev": 20},
        "gravity": {"torque": 5.0, "angle": 0.3},
        "extra_mode": {"mass": 0.5, "stiffness": 4000.0},
        "coupling_stiffness": {"stiffness": 500.0},
        "payload_change": {"mass": 2.0, "time": 0.05},
        "parameter_drift": {"rate": 500.0},
        "base_compliance": {"mass": 40.0, "stiffness": 2e5},
    }
    chains = case_study(damping_ratio=0.01)
    bare = run(plant(chains), excitation, 0.4)
    moved = {}
    for cause, values in parameters.items():
        effect = {"cause": cause, "axis": "A1", "parameters": values}
        if cause == "coupling_stiffness":
            effect["other_axis"] = "A2"
        rows = run(plant(chains, effect), excitation, 0.4)[:, :9]
        assert np.isfinite(rows).all()
        moved[cause] = np.abs(rows - bare).max()
    assert min(moved.values()) > 1e-5, moved
    at_the_motor = {
        "torque_delay",
        "torque_lag",
        "torque_gain",
        "torque_saturation",
        "encoder_eccentricity",
        "dropped_samples",
    }
    assert set(parameters) | at_the_motor == set(CAUSES)
