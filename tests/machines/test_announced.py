"""What is announced bounds what the plant itself does, in every phase of a whole run in virtual time."""

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from invid.config import load_config
from machines.cells import Drawn, Truth, by_default, draw, run, try_signs

CASE_STUDY = Path(__file__).parents[2] / "configs" / "case-study.yaml"


def with_rated_torque(drawn: Drawn, factor: float) -> Drawn:
    """0x6076 says ``factor`` times what the plates say, and the config leaves that to the drives."""
    simulation: dict[str, Any] = copy.deepcopy(drawn.config.simulation or {})
    axes = []
    for i, axis in enumerate(drawn.config.axes):
        rated, inertia = axis.rated_torque or 0.0, axis.inertia
        if inertia is None:
            inertia = 1.1 * sum(simulation["plant"]["branches"][i]["masses"])
        drive = simulation.setdefault("axes", {}).setdefault(axis.name, {})
        drive["rated_torque_Nm"] = rated
        drive.setdefault("objects", {})["values"] = {"0x6076": round(1000 * factor * rated)}
        axes.append(axis.model_copy(update={"rated_torque": None, "inertia": inertia}))
    config = drawn.config.model_copy(update={"axes": axes, "simulation": simulation})
    return replace(drawn, config=config, model=None)


BY_NIGHT = pytest.mark.campaign


def assert_bounded(truth: Truth) -> None:
    """It was measured, within what was announced; drives that stop by themselves keep the limits."""
    assert truth.error is None
    assert truth.ratios().max() <= 1.0
    assert truth.left.max() <= 1.0


@pytest.mark.parametrize("seed", [pytest.param(s, marks=BY_NIGHT) for s in (302, 305, 307, 410, 422)])
def test_no_axis_does_more_than_was_announced_in_any_phase_and_the_run_lasts_as_planned(seed: int) -> None:
    drawn = draw(seed)
    truth = run(drawn)
    assert_bounded(truth)
    assert truth.clipped == 0
    assert truth.seconds == pytest.approx(truth.plan.duration_s, rel=0.05)
    assert {f.basis for f in truth.after} == ({"trial"} if drawn.model is None else {"model"})
    assert np.median(truth.generosity()[2]) < 3.0


@pytest.mark.parametrize(
    ("seed", "until"),
    [
        # soft axes that swing on from doublet to doublet, with nothing that holds them
        (9116, "trying the signs of A2"),
        pytest.param(9133, "trying the signs of A1", marks=BY_NIGHT),
        # let go while the load swings behind it: the branch drifts
        pytest.param(9127, "trying the signs of A3", marks=BY_NIGHT),
        # the loop around other phases than those tried
        pytest.param(9107, "experiment 2 of 4", marks=BY_NIGHT),
    ],
)
def test_what_swings_drifts_or_is_led_stays_within_what_was_announced(seed: int, until: str) -> None:
    truth = run(draw(seed), until)
    assert_bounded(truth)
    assert until in truth.peaks


@pytest.mark.parametrize(
    "drawn",
    [
        pytest.param(
            by_default(draw(9349)), id="light axes feel a heavy one before its encoder shows a count"
        ),
        # a load that swings when its axis is let go moves it further than the first doublets
        pytest.param(by_default(draw(9353)), id="swings", marks=BY_NIGHT),
        pytest.param(
            by_default(draw(9327)), id="and makes it look lighter than its first mass", marks=BY_NIGHT
        ),
        # brought back to rest after a run with less torque than the limit allows
        pytest.param(by_default(draw(9336)), id="brought back", marks=BY_NIGHT),
        # a light axis that swings allows 3 % of the torque; A2 and A5 stand under that and are not stuck
        pytest.param(draw(9094), id="friction holds", marks=BY_NIGHT),
    ],
)
def test_what_swings_and_what_hardly_moves_is_measured_within_the_announcement(drawn: Drawn) -> None:
    assert_bounded(run(drawn))


@pytest.mark.parametrize("seed", [420, *(pytest.param(s, marks=BY_NIGHT) for s in (401, 413, 415, 418, 423))])
def test_an_axis_that_swings_is_not_taken_for_one_with_a_wrong_scale(seed: int) -> None:
    # Masses behind springs of 1 to 5 Hz, or friction above the slow doublet: the motor moves like a third or
    # like ten times of the axis.
    assert try_signs(draw(seed)) is None


@pytest.mark.parametrize("factor", [0.2, 5.0])
@pytest.mark.parametrize("seed", [405, *(pytest.param(s, marks=BY_NIGHT) for s in (444, 448))])
def test_a_rigid_axis_five_times_off_is_refused(seed: int, factor: float) -> None:
    drawn = draw(seed)
    first = drawn.config.axes[0]
    inertia = factor * sum(drawn.config.simulation["plant"]["branches"][0]["masses"])  # type: ignore[index]
    axes = [first.model_copy(update={"inertia": inertia}), *drawn.config.axes[1:]]
    said = try_signs(replace(drawn, config=drawn.config.model_copy(update={"axes": axes})))
    assert said is not None
    assert said.code == "scales"
    assert said.axis == first.name


# Of the case study the first mass is a sixteenth of the branch: only a doublet that all masses follow tells.
@pytest.mark.parametrize(
    ("seed", "factor"),
    [(11, 10.0), (None, 0.1), *(pytest.param(s, 10.0, marks=BY_NIGHT) for s in (16, 23))],
)
def test_an_elastic_axis_whose_torque_is_a_tenth_or_ten_times_what_its_drive_says_is_refused(
    seed: int | None, factor: float
) -> None:
    drawn = Drawn(load_config(CASE_STUDY), None, 1.0) if seed is None else draw(seed)
    said = try_signs(with_rated_torque(drawn, factor))
    assert said is not None
    assert said.code == "scales"
