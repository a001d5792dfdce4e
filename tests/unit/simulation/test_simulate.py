"""The simulator against scipy's integrator with the physics written again here."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from invid.errors import InputError, ModelError
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, EffectTerm, Estimate, Model
from invid.model.law_table import LawTable
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.simulation.run import simulate

RATE = 500.0
LINES = np.array([1.0, 1.5, 2.5, 3.5, 4.5, 6.5, 8.5])


def plant() -> CoupledChains:
    return CoupledChains.build(
        [[1.0, 1.5], [2.0, 3.0]],
        [[800.0], [1500.0]],
        [[1.0], [1.5]],
        [[0, 0.6], [0.6, 0]],
    )


def torque_at(t: np.ndarray, amplitude: float = 3.0) -> np.ndarray:
    phases = np.random.default_rng(3).uniform(0, 2 * np.pi, (2, LINES.size))
    angle = 2 * np.pi * LINES * np.asarray(t)[..., None, None] + phases
    return amplitude * np.sin(angle).sum(axis=-1)


def model(chains: CoupledChains, *effects: EffectTerm, linear: bool = False) -> Model:
    return Model("r", "test", chains, ChainStd.unknown(chains), linear=linear, effects=effects)


def effect(
    cause: str, axis: str = "A1", element: str | None = None, other: str | None = None, **values: float
) -> EffectTerm:
    return EffectTerm(cause, axis, {k: Estimate(v) for k, v in values.items()}, element, other)


def recording(time: np.ndarray, position: np.ndarray, torque: np.ndarray, **changes: object) -> Recording:
    experiment = Experiment(
        key="000",
        kind=Kind.MULTISINE,
        role=Role.IDENTIFY,
        excited_axis=-1,
        hold_gain=np.zeros(position.shape[1]),
        period_samples=0,
        frequencies_hz=LINES,
        sample_rate_hz=RATE,
        time=time,
        position=position,
        torque=torque,
    )
    experiment = dataclasses.replace(experiment, **changes)  # type: ignore[arg-type]
    axes = tuple(f"A{i + 1}" for i in range(position.shape[1]))
    return Recording("r", axes, "rad", "N·m", "2026-01-01T00:00:00Z", (experiment,))


Force = Callable[[float, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def reference(
    chains: CoupledChains,
    extra: Force,
    *,
    duration: float = 3.0,
    acting: Callable[[float], np.ndarray] = torque_at,
    start: tuple[float, ...] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Times and motor positions by scipy; ``extra(t, q, v, z)`` is a force on all coordinates."""
    n = chains.dofs
    inverse = np.linalg.inv(chains.mass_matrix)
    stiffness, damping = chains.stiffness_matrix, chains.damping_matrix

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        q, v = x[:n], x[n : 2 * n]
        force = extra(t, q, v, x)
        force[chains.motor_dofs] += acting(t)
        return np.concatenate((v, inverse @ (force - stiffness @ q - damping @ v)))

    time = np.arange(round(duration * RATE)) / RATE
    x0 = np.zeros(2 * n)
    x0[: len(start)] = start
    answer = solve_ivp(
        slope, (0, time[-1]), x0, t_eval=time, method="LSODA", rtol=1e-8, atol=1e-10, max_step=2e-3
    )
    assert answer.success
    return time, answer.y[chains.motor_dofs].T


def nothing(t: float, q: np.ndarray, v: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.zeros(q.size)


def relative(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.mean((found - truth) ** 2) / np.mean((truth - truth.mean(axis=0)) ** 2)))


def test_the_linear_answer_is_that_of_an_independent_integrator() -> None:
    time, truth = reference(plant(), nothing)
    answer = simulate(model(plant()), recording(time, truth, torque_at(time)))
    assert relative(answer.experiments[0].position, truth) < 1e-4


def _on(q: int, value: float) -> np.ndarray:
    force = np.zeros(4)
    force[q] = value
    return force


def _pair(a: int, value: float) -> np.ndarray:
    force = np.zeros(4)
    force[a], force[a + 1] = value, -value
    return force


SHARP = 2e-4


def law_of_two(
    over: str, across: str, element: str, most: tuple[float, float], law: Callable[..., np.ndarray]
) -> EffectTerm:
    """A law without a name over two quantities: 21 by 21 of its values within ±``most``."""
    at, beside = (np.linspace(-m, m, 21) for m in most)
    value = law(*np.meshgrid(at, beside, indexing="ij")).ravel()
    known = ((0.0,) * value.size,) * value.size
    table = LawTable(
        over, tuple(at.tolist()), "", tuple(value.tolist()), "", known, across, tuple(beside.tolist()), ""
    )
    size = {"torque": Estimate(float(np.abs(value).max()))}
    return EffectTerm("empirical_law", "A1", size, element, None, table)


CASES: dict[str, tuple[EffectTerm, Force, float]] = {
    "coulomb": (
        effect("coulomb_friction", "A1", "mass 1", torque=2.0),
        lambda t, q, v, x: _on(0, -2.0 * np.tanh(v[0] / SHARP)),
        0.02,
    ),
    "coulomb on the load": (
        effect("coulomb_friction", "A2", "mass 2", torque=2.0),
        lambda t, q, v, x: _on(3, -2.0 * np.tanh(v[3] / SHARP)),
        0.02,
    ),
    "viscous": (
        effect("viscous_friction", "A2", "mass 1", coefficient=3.0),
        lambda t, q, v, x: _on(2, -3.0 * v[2]),
        1e-3,
    ),
    "stribeck": (
        effect("stribeck_friction", "A1", "mass 1", static=3.0, coulomb=1.5, velocity=0.05),
        lambda t, q, v, x: _on(0, -(1.5 + 1.5 * np.exp(-((v[0] / 0.05) ** 2))) * np.tanh(v[0] / SHARP)),
        0.03,
    ),
    "asymmetric": (
        effect(
            "asymmetric_friction",
            "A1",
            "mass 1",
            coulomb_positive=2.0,
            coulomb_negative=0.5,
            viscous_positive=1.0,
            viscous_negative=3.0,
        ),
        lambda t, q, v, x: _on(
            0,
            -(2.0 if v[0] > 0 else 0.5) * np.tanh(v[0] / SHARP) - (1.0 if v[0] > 0 else 3.0) * v[0],
        ),
        0.02,
    ),
    "cogging": (
        effect("cogging", "A2", torque=2.0, cycles_per_rev=40.0, phase=0.7),
        lambda t, q, v, x: _on(2, -2.0 * np.sin(40 * q[2] + 0.7)),
        5e-3,
    ),
    "gravity": (
        effect("gravity", "A1", torque=5.0, angle=0.4),
        lambda t, q, v, x: _on(1, -5.0 * np.sin(q[1] + 0.4)),
        5e-3,
    ),
    "cubic": (
        effect("cubic_stiffness", "A1", "spring 1", coefficient=2e6),
        lambda t, q, v, x: _pair(0, -2e6 * (q[0] - q[1]) ** 3),
        5e-3,
    ),
    "spring damping": (
        effect("spring_damping", "A2", "spring 1", coefficient=4.0),
        lambda t, q, v, x: _pair(2, -4.0 * (v[2] - v[3])),
        1e-3,
    ),
    "backlash": (
        effect("backlash", "A1", "spring 1", gap=0.004),
        lambda t, q, v, x: _pair(
            0,
            800.0 * np.clip(q[0] - q[1], -0.002, 0.002)
            + (1.0 * (v[0] - v[1]) if abs(q[0] - q[1]) < 0.002 else 0.0),
        ),
        0.02,
    ),
    "coupling stiffness": (
        effect("coupling_stiffness", "A1", None, "A2", stiffness=300.0),
        lambda t, q, v, x: np.array([0, -300.0 * (q[1] - q[3]), 0, 300.0 * (q[1] - q[3])]),
        1e-3,
    ),
    "transmission error": (
        effect("transmission_error", "A1", "spring 1", amplitude=0.002, cycles_per_rev=50.0, phase=0.3),
        lambda t, q, v, x: _transmission(q),
        5e-3,
    ),
    "drag that grows off its place": (
        law_of_two(
            "velocity", "position", "mass 1", (3.0, 1.0), lambda v, q: 2.0 * v * (1.0 + 20.0 * (q - 0.1) ** 2)
        ),
        lambda t, q, v, x: _on(0, -2.0 * v[0] * (1.0 + 20.0 * (q[0] - 0.1) ** 2)),
        5e-3,
    ),
    "damping that grows with deflection": (
        law_of_two("deflection", "deflection rate", "spring 1", (0.05, 0.5), lambda d, w: 2e4 * d * d * w),
        lambda t, q, v, x: _pair(0, -2e4 * (q[0] - q[1]) ** 2 * (v[0] - v[1])),
        5e-3,
    ),
}


def _transmission(q: np.ndarray) -> np.ndarray:
    """From the potential ½K(d − e(q_s))²: the force is minus its gradient, less the linear part."""
    deflection = q[0] - q[1]
    error, slope = 0.002 * np.sin(50 * q[0] + 0.3), 0.002 * 50 * np.cos(50 * q[0] + 0.3)
    force = np.zeros(4)
    force[0] = -800.0 * (deflection - error) * (1 - slope) + 800.0 * deflection
    force[1] = 800.0 * (deflection - error) - 800.0 * deflection
    return force


@pytest.mark.parametrize("name", CASES)
def test_every_force_law_agrees_with_an_independent_integrator(name: str) -> None:
    term, force, tolerance = CASES[name]
    time, truth = reference(plant(), force)
    record = recording(time, truth, torque_at(time))
    with_effect = relative(simulate(model(plant(), term), record).experiments[0].position, truth)
    without = relative(simulate(model(plant()), record).experiments[0].position, truth)
    assert with_effect < tolerance
    assert without > 10 * with_effect  # the effect matters in this record, so the test can fail


ACTUATORS: dict[str, tuple[EffectTerm, Callable[[float], np.ndarray]]] = {
    "gain": (effect("torque_gain", "A1", gain=1.1), lambda t: torque_at(t) * [1.1, 1.0]),
    "delay": (
        effect("torque_delay", "A1", delay=0.006),
        lambda t: np.array([torque_at(t - 0.006)[0], torque_at(t)[1]]),
    ),
    "lead": (
        effect("torque_delay", "A1", delay=-0.006),
        lambda t: np.array([torque_at(t + 0.006)[0], torque_at(t)[1]]),
    ),
    "saturation": (
        effect("torque_saturation", "A1", limit=4.0),
        lambda t: np.array([np.clip(torque_at(t)[0], -4, 4), torque_at(t)[1]]),
    ),
}


@pytest.mark.parametrize("name", ACTUATORS)
def test_actuator_effects_change_the_torque_that_acts(name: str) -> None:
    term, acting = ACTUATORS[name]
    time, truth = reference(plant(), nothing, acting=acting)
    record = recording(time, truth, torque_at(time))
    assert relative(simulate(model(plant(), term), record).experiments[0].position, truth) < 1e-3
    assert relative(simulate(model(plant()), record).experiments[0].position, truth) > 5e-3


def shaken(begin: float = 0.0, motion: float = 0.02) -> Recording:
    """Three seconds of torque beside a motion that is no model's: only models are compared on it."""
    time = np.arange(round(3.0 * RATE)) / RATE
    position = motion * np.sin(2 * np.pi * np.outer(time, [1.0, 1.5]))
    return recording(time + begin, position, torque_at(time))


@pytest.mark.parametrize(("element", "rate"), [("spring 1", -0.1), ("mass 1", 1e-4)])
def test_a_drift_goes_on_from_one_experiment_to_the_next(element: str, rate: float) -> None:
    """Twenty minutes later, in which little drifts within three seconds, it is another plant."""
    chains = plant()
    own = {"spring 1": {"springs": chains.springs}, "mass 1": {"masses": chains.masses}}[element]
    ((name, (values, other)),) = own.items()
    changed = values.copy()
    changed[0] += 1201.5 * rate
    drifted = dataclasses.replace(chains, **{name: (changed, other)})
    truth = simulate(model(drifted), shaken(begin=1200.0)).experiments[0]
    later = dataclasses.replace(truth, key="001")
    both = dataclasses.replace(shaken(), experiments=(*shaken().experiments, later))
    drift = effect("parameter_drift", "A1", element, rate=rate)
    found = simulate(model(chains, drift), both, only=["001"]).experiments[0].position
    assert relative(found, truth.position) < 0.01
    without = simulate(model(chains), both, only=["001"]).experiments[0].position
    assert relative(without, truth.position) > 0.05


def test_a_hold_gain_is_replayed_as_a_closed_loop() -> None:
    held = dataclasses.replace(
        plant(), ground_springs=np.array([0.0, 400.0]), ground_dampers=np.array([2.0, 5.0])
    )
    time, truth = reference(held, nothing)
    seen = torque_at(time)
    rate = np.gradient(truth, time, axis=0)
    seen = seen - truth * [0.0, 400.0] - rate * [2.0, 5.0]
    record = recording(time, truth, seen, hold_gain=np.array([0.0, 400.0]))
    answer = simulate(model(plant()), record)
    assert relative(answer.experiments[0].position, truth) < 5e-3


@pytest.mark.parametrize(
    ("term", "words"),
    [
        (effect("magic", "A1"), "cannot be simulated"),
        (effect("coulomb_friction", "A9", torque=1.0), "no branch"),
        (effect("coulomb_friction", "A1", "spring 1", torque=1.0), "mass n"),
        (effect("backlash", "A1", "spring 2", gap=0.1), "spring 2 of 1"),
        (effect("coulomb_friction", "A1"), "torque"),
        (effect("coupling_stiffness", "A1", stiffness=1.0), "other_axis"),
        (effect("torque_lag", "A1", time_constant=0.0), "time_constant"),
    ],
)
def test_effects_that_cannot_be_simulated_are_named(term: EffectTerm, words: str) -> None:
    record = recording(np.arange(100) / RATE, np.zeros((100, 2)), np.zeros((100, 2)))
    with pytest.raises(ModelError, match=words):
        simulate(model(plant(), term), record)


def test_a_model_whose_motion_explodes_is_refused_and_writes_nothing() -> None:
    time, truth = reference(plant(), nothing, duration=1.0)
    term = effect("viscous_friction", "A1", "mass 1", coefficient=-500.0)
    with pytest.raises(InputError, match="feeds energy in"):
        simulate(model(plant(), term), recording(time, truth, torque_at(time)))
