"""The values on a plant by MuJoCo, with a controller of this file: friction, free play, a mode, another tool.

Two bodies on hinges; the spring is a fixed tendon that acts beyond ±gap/2; nothing of ``invid`` runs in the
loop but the numbers it gave.
"""

from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np
import pytest

from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm, Estimate, Model, parameter_vector, std_by_name
from invid.tuning.axis_loop import AxisLoop
from invid.tuning.simulated_loops import move_figures, reference_move, run_loops
from invid.tuning.tune import AxisTuning, TuneSettings, Tuning, tune_model

pytestmark = pytest.mark.campaign
CYCLE, SUBSTEPS = 0.001, 20
MOTOR, SPRING, DAMPER = 0.02, 200.0, 0.03
OLD_LOAD, NEW_LOAD = 0.03, 0.09
DRY, WET, GAP = 0.3, 0.05, 0.0015


def model(load: float) -> Model:
    chains = CoupledChains.build([[MOTOR, load]], [[SPRING]], [[DAMPER]], axes=["A1"])
    names, values = parameter_vector(chains)
    std = std_by_name(chains, {n: 0.02 * abs(v) for n, v in zip(names, values, strict=True)})

    def term(cause: str, element: str, **sizes: float) -> EffectTerm:
        return EffectTerm(cause, "A1", {k: Estimate(v, 0.02 * v) for k, v in sizes.items()}, element)

    return Model("robot", "refined", chains, std).extended(
        term("coulomb_friction", "mass 1", torque=DRY),
        term("viscous_friction", "mass 1", coefficient=WET),
        term("backlash", "spring 1", gap=GAP),
    )


@cache
def tuned(load: float) -> Tuning:
    return tune_model(model(load), TuneSettings(draws=100))


@dataclass
class Figures:
    """Following error of the motor and error of the load, rms [rad], and the largest swing after the move."""

    following: float
    at_load: float
    left: float


def run_in_mujoco(loop: AxisLoop, load: float, *, gap: float = GAP) -> Figures:
    """The reference move, sampled and late as a drive is."""
    plant = mujoco.MjModel.from_xml_string(f"""
      <mujoco>
        <option timestep="{CYCLE / SUBSTEPS}" integrator="implicitfast" gravity="0 0 0"/>
        <worldbody>
        <body><joint name="m" type="hinge" axis="0 0 1" damping="{WET}" frictionloss="{DRY}"
          solreffriction="0.0002 1" solimpfriction="0.99 0.999 0.0001"/>
          <inertial pos="0 0 0" mass="1" diaginertia="{MOTOR} {MOTOR} {MOTOR}"/></body>
        <body><joint name="l" type="hinge" axis="0 0 1"/>
          <inertial pos="0 0 0" mass="1" diaginertia="{load} {load} {load}"/></body>
      </worldbody>
      <tendon><fixed stiffness="{SPRING}" damping="{0.0 if gap else DAMPER}"
        springlength="{-gap / 2} {gap / 2}">
        <joint joint="m" coef="1"/><joint joint="l" coef="-1"/></fixed></tendon>
      <actuator><motor joint="m"/></actuator></mujoco>""")
    data = mujoco.MjData(plant)
    command = tuned(load).command
    r, v, a = (x[:, 0] for x in (command.position, command.velocity, command.acceleration))
    if loop.shaper is not None:
        time = np.arange(r.size) * CYCLE
        pulses = list(zip(loop.shaper.times, loop.shaper.amplitudes, strict=True))
        r, v, a = (sum(s * np.interp(time - t, time, x) for t, s in pulses) for x in (r, v, a))
    g, f = loop.gains, loop.feedforward
    filters = [(*n.coefficients(CYCLE), np.zeros(2)) for n in g.notches]
    integral = last = pending = 0.0
    seen = np.zeros((r.size, 2))
    for k in range(r.size):
        seen[k] = data.qpos
        speed, last = (data.qpos[0] - last) / CYCLE, float(data.qpos[0])
        error = g.position_gain * (r[k] - last) + v[k] - speed
        integral += error * CYCLE / g.integral_time
        u = g.velocity_gain * (error + integral)
        for b, den, kept in filters:
            y = b[0] * u + kept[0]
            kept[:] = b[1] * u - den[1] * y + kept[1], b[2] * u - den[2] * y
            u = y
        rub = f.dry * np.tanh(v[k] / (0.02 * np.abs(v).max()))
        data.ctrl[0], pending = pending, u + f.inertia * a[k] + f.viscous * v[k] + rub
        for _ in range(SUBSTEPS):
            mujoco.mj_step(plant, data)
    rest = slice(command.arrived + 200, command.leaves)
    rms = [float(np.sqrt(np.mean((r - seen[:, i]) ** 2))) for i in (0, 1)]
    return Figures(*rms, float(np.ptp(seen[rest, 1])))


def axis(load: float) -> AxisTuning:
    return tuned(load).axes[0]


@pytest.mark.panel
def test_the_tuned_values_follow_better_than_the_timid_ones():
    before, after = (run_in_mujoco(x, OLD_LOAD) for x in (axis(OLD_LOAD).before, axis(OLD_LOAD).after))
    assert after.following < 0.2 * before.following
    assert after.at_load < 0.5 * before.at_load
    assert after.left < before.left


def test_both_simulators_see_the_same_errors():
    for loop, figures in (
        (axis(OLD_LOAD).before, axis(OLD_LOAD).before.move),
        (axis(OLD_LOAD).after, axis(OLD_LOAD).after.move),
    ):
        there = run_in_mujoco(loop, OLD_LOAD)
        assert there.following == pytest.approx(figures.following, rel=0.15)
        assert there.at_load == pytest.approx(figures.at_load, rel=0.15)


def test_tuning_anew_for_the_new_tool_pays():
    stale, fresh = (run_in_mujoco(axis(load).after, NEW_LOAD) for load in (OLD_LOAD, NEW_LOAD))
    # The rest is free play, which no value mends.
    assert fresh.following < 0.95 * stale.following
    assert fresh.at_load < 0.85 * stale.at_load
    assert fresh.left < 0.75 * stale.left


def test_invids_own_plant_says_the_same_of_the_stale_values():
    command = reference_move(tuned(NEW_LOAD).plant, TuneSettings().timing)
    run = run_loops(model(NEW_LOAD), [axis(OLD_LOAD).after], command, TuneSettings().timing)
    stale = move_figures(run, command)[0]
    assert stale.following > axis(NEW_LOAD).after.move.following
    assert stale.following == pytest.approx(run_in_mujoco(axis(OLD_LOAD).after, NEW_LOAD).following, rel=0.15)
