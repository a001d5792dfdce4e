"""Loops, margins and shapers against python-control and against integration by others."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from invid.tuning.shapers import choose_shaper, residual_vibration


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
