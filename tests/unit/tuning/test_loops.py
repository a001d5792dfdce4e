"""Loops, margins and shapers against python-control and against integration by others."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tuning.tuned import machine

from invid.exchange.linear_plant import linear_plant
from invid.model.document import Model
from invid.tuning.feedforward import NONE
from invid.tuning.servo_loop import DriveTiming, Gains, Notch, closed_loop
from invid.tuning.shapers import choose_shaper, residual_vibration
from invid.tuning.simulated_loops import AxisLoop, reference_move, run_loops

TIMING = DriveTiming(0.001)
GAINS = (
    Gains(1.2, 0.05, 12.0, (Notch(45.0, 0.1, 0.6),)),
    Gains(1.8, 0.08, 9.0, (Notch(60.0, 0.1, 0.5), Notch(110.0, 0.2, 0.8))),
)


def linear_machine() -> Model:
    return Model("robot", "refined", machine().chains, machine().std)


def test_a_loop_is_stable_where_its_simulation_stays_and_unstable_where_it_runs_away():
    model = linear_machine()
    plant = linear_plant(model)
    command = reference_move(plant, TIMING)
    for factor, calm in ((1.0, True), (30.0, False)):
        gains = tuple(Gains(factor * g.velocity_gain, 0.05, 10.0) for g in GAINS)
        run = run_loops(model, [AxisLoop(g, NONE) for g in gains], command, TIMING)
        assert closed_loop(plant, gains, TIMING).is_stable is calm
        assert bool(np.isfinite(run.motor).all()) is calm


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
