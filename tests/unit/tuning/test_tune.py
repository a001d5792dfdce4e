"""Values of a whole machine: what they promise, on machines and data that the design has not seen."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tuning.tuned import machine, tuned

from invid.errors import NotIdentifiableError
from invid.exchange.linear_plant import linear_plant
from invid.tuning.document import tuning_to_json
from invid.tuning.gains import PROMISE
from invid.tuning.margins import worst_margins
from invid.tuning.plant_draws import drawn_models
from invid.tuning.shapers import choose_shaper, residual_vibration
from invid.tuning.simulated_loops import run_loops
from invid.tuning.tune import TuneSettings, tune_model
from invid.wording.sentence import say


def test_margins_hold_in_machines_drawn_anew():
    tuning = tuned()
    rng = np.random.default_rng(12345)
    fresh = [linear_plant(m) for m in drawn_models([machine()], 200, rng)]
    gains = tuple(a.after.gains for a in tuning.axes)
    for margins in worst_margins(fresh, gains, tuning.settings.timing, PROMISE):
        assert margins.unstable == 0
        assert margins.kept >= 0.98


def test_the_move_is_better_than_with_the_timid_gains():
    for axis in tuned().axes:
        assert axis.after.move.following < 0.3 * axis.before.move.following
        assert axis.after.move.at_load < axis.before.move.at_load
        assert np.isfinite(axis.after.move.settling)


def test_an_encoder_so_coarse_that_no_loop_holds_the_axis_is_refused_with_the_ripple_of_one_that_does():
    stated = {"encoder_resolution": 2 * np.pi / 4096, "rated_torque": 2.0}
    coarse = replace(machine(), provenance={"sensors": {"A1": stated, "A2": stated}})
    with pytest.raises(NotIdentifiableError, match="no loop that holds it") as refused:
        tune_model(coarse, TuneSettings(draws=50))
    assert "--ripple" in str(refused.value.way_out)


def test_coarse_encoders_bound_the_gains_and_the_torque_they_make_is_the_one_foretold():
    count, rated = 2 * np.pi / 2**17, 8.0
    stated = {"encoder_resolution": count, "rated_torque": rated}
    coarse = replace(machine(), provenance={"sensors": {"A1": stated, "A2": stated}})
    tuning = tune_model(coarse, TuneSettings(draws=50))
    loops = [a.after for a in tuning.axes]
    timing, move = tuning.settings.timing, slice(0, tuning.command.arrived)
    ideal = run_loops(coarse, loops, tuning.command, timing)
    shown = run_loops(coarse, loops, tuning.command, timing, np.full(2, count))
    for i, axis in enumerate(tuning.axes):
        foretold = axis.after.margins.ripple
        assert foretold <= 1.15 * 0.01 * rated
        assert np.std((shown.torque - ideal.torque)[move, i]) == pytest.approx(foretold, rel=0.3)
        assert axis.after.gains.velocity_gain < 0.8 * tuned().axes[i].after.gains.velocity_gain
    assert not any("not bounded" in r for r in tuning.remarks)
    assert any("not bounded" in r for r in tuned().remarks)
    said = [say(text, "de") for text in tuning_to_json(tuned())["remarks"]]
    assert any("nicht begrenzt" in r for r in said)
    assert not any(" the " in r for r in said)


def test_a_model_that_is_not_to_be_trusted_is_refused():
    with pytest.raises(NotIdentifiableError, match="not to be trusted"):
        tune_model(replace(machine(), fit={"trustworthy": False}), TuneSettings())


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
