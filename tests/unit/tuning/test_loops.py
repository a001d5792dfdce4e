"""Loops, margins and shapers against python-control and against integration by others."""

from __future__ import annotations

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tuning.tuned import machine

from invid.exchange.linear_plant import linear_plant
from invid.model.document import Model
from invid.tuning.feedforward import NONE
from invid.tuning.margins import axis_margins, drawn_plants
from invid.tuning.servo_loop import DriveTiming, Gains, Notch, closed_loop, controller, controller_response
from invid.tuning.shapers import choose_shaper, residual_vibration
from invid.tuning.simulated_loops import AxisLoop, reference_move, run_loops

TIMING = DriveTiming(0.001)
GAINS = (
    Gains(1.2, 0.05, 12.0, (Notch(45.0, 0.1, 0.6),)),
    Gains(1.8, 0.08, 9.0, (Notch(60.0, 0.1, 0.5), Notch(110.0, 0.2, 0.8))),
)


def linear_machine() -> Model:
    return Model("robot", "refined", machine().chains, machine().std)


def test_a_controller_answers_as_its_state_space_does():
    hz = np.geomspace(0.1, 400.0, 50)
    z = np.exp(2j * np.pi * hz * TIMING.cycle)
    system = controller(GAINS[1], TIMING)
    response = controller_response(GAINS[1], TIMING, 2 * np.pi * hz)
    assert np.allclose([system(x) for x in z], response, rtol=1e-6)


def test_margins_are_those_of_python_control():
    drawn = drawn_plants([linear_plant(linear_machine())], TIMING)
    for i in range(2):
        loop = drawn.loops(GAINS)[..., i]
        gain, phase, peak = axis_margins(loop)
        omega = drawn.omega[0]
        found = control.stability_margins(
            (np.abs(loop[0]), np.degrees(np.unwrap(np.angle(loop[0]))), omega), returnall=True
        )
        both = np.concatenate([found[0], 1.0 / found[0]])
        assert gain[0] == pytest.approx(both[both >= 1.0].min(), rel=0.02)
        assert phase[0] == pytest.approx(np.abs(found[1]).min(), abs=1.0)
        assert peak[0] == pytest.approx(1.0 / found[2].min(), rel=0.02)


def test_a_loop_is_stable_where_its_simulation_stays_and_unstable_where_it_runs_away():
    model = linear_machine()
    plant = linear_plant(model)
    command = reference_move(plant, TIMING)
    for factor, calm in ((1.0, True), (30.0, False)):
        gains = tuple(Gains(factor * g.velocity_gain, 0.05, 10.0) for g in GAINS)
        run = run_loops(model, [AxisLoop(g, NONE) for g in gains], command, TIMING)
        assert closed_loop(plant, gains, TIMING).is_stable is calm
        assert bool(np.isfinite(run.motor).all()) is calm


def test_the_simulated_loops_decay_as_the_slowest_pole_says():
    model = linear_machine()
    plant = linear_plant(model)
    command = reference_move(plant, TIMING)
    run = run_loops(model, [AxisLoop(g, NONE) for g in GAINS], command, TIMING)
    poles = closed_loop(plant, GAINS, TIMING).poles
    rest = slice(command.leaves - 400, command.leaves)
    left = run.motor[rest, 0] - command.position[rest, 0]
    # an autoregression of the response finds the poles that are left in it
    order = 8
    rows = np.lib.stride_tricks.sliding_window_view(left, order + 1)
    weights = np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=1e-13)[0]
    slowest = max(np.abs(np.roots([1.0, *-weights[::-1]])))
    assert slowest == pytest.approx(np.abs(poles).max(), abs=2e-3)


def test_a_shaped_command_leaves_an_oscillator_at_rest_and_one_a_tenth_off_within_the_tolerance():
    f, damping = 4.0, 0.03
    shaper = choose_shaper((f, damping), [(f * x, damping) for x in (0.9, 1.1)])
    assert shaper is not None

    def swing(frequency: float) -> float:
        w = 2 * np.pi * frequency
        time = np.arange(0.0, 2.0, 1e-3)
        command = shaper.shape((time > 0.1).astype(float), 1e-3)

        def rate(t: float, x: np.ndarray) -> list[float]:
            return [x[1], w * w * (np.interp(t, time, command) - x[0]) - 2 * damping * w * x[1]]

        end = solve_ivp(rate, (0, 0.1 + shaper.times[-1] + 0.002), [0.0, 0.0], max_step=1e-3, rtol=1e-8).y[
            :, -1
        ]
        free = np.exp(-damping * w * shaper.times[-1])
        return float(np.hypot(end[0] - 1.0, end[1] / w)) / free

    assert swing(f) < 0.06
    for off in (0.9, 1.1):
        assert swing(f * off) == pytest.approx(residual_vibration(shaper, f * off, damping), abs=0.08)
        assert residual_vibration(shaper, f * off, damping) <= 0.1


def test_a_mode_that_the_loop_damps_needs_no_shaper():
    assert choose_shaper((4.0, 0.6), []) is None
