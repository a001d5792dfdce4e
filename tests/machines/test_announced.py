"""What is announced bounds what the plant itself does, in every phase of a whole run in virtual time."""

from pathlib import Path

import numpy as np
import pytest

from invid.config import load_config
from invid.errors import ConfigError
from invid.planning.subset import axes_left_out, require_all_axes
from machines.cells import draw, run

CASE_STUDY = Path(__file__).parents[2] / "configs" / "case-study.yaml"


@pytest.mark.parametrize("seed", [302, 305, 307])
def test_no_axis_does_more_than_was_announced_in_any_phase_and_the_run_lasts_as_planned(seed: int) -> None:
    drawn = draw(seed)
    truth = run(drawn)
    assert truth.error is None
    assert truth.clipped == 0
    assert truth.ratios().max() <= 1.0
    assert truth.seconds == pytest.approx(truth.plan.duration_s, rel=0.05)
    assert {f.basis for f in truth.after} == ({"trial"} if drawn.model is None else {"model"})
    assert np.median(truth.generosity()[2]) < 3.0


def test_a_subset_of_the_axes_is_refused_with_the_way_out() -> None:
    config = load_config(CASE_STUDY)
    with pytest.raises(ConfigError, match=r"axis A2, A3 would be held.*--screen"):
        require_all_axes(config, ["A1"])
    require_all_axes(config, ["A3", "A1", "A2"])
    require_all_axes(config, None)
    assert axes_left_out(config, ["A1", "A3"]) == ("A2",)
