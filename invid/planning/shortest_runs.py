"""The default plan, no longer than what is to be known asks for."""

from __future__ import annotations

from invid.config import CellConfig, MultisineSpec
from invid.planning.belief import Belief
from invid.planning.build import DEFAULT, make_plan
from invid.planning.detection import detection_limits
from invid.planning.expected_covariance import Noise, expected

LENGTHS_S = (5.0, 6.5, 8.0)
"""Lengths of a run that are tried before that of the default plan, the longest: with it three axes take a
minute. Shorter than 5 s the lines lie so far apart that a fit from nothing may miss a resonance."""
UNCERTAINTY = 0.01
"""Expected relative deviation of every mass, spring and coupling."""


def shortest_runs(config: CellConfig, belief: Belief, noise: Noise) -> MultisineSpec:
    """The shortest runs that are expected to tell every parameter to 1 % and to show the sizes of interest;
    those of the default plan where none is."""
    for length in LENGTHS_S:
        spec = DEFAULT.model_copy(update={"period_s": length})
        plan = make_plan(config.model_copy(update={"experiments": [spec]}), model=belief)
        limits = detection_limits(config, plan.recorded, belief, noise)
        shows = all(limit.is_met for limit in limits)
        if shows and expected(config, plan, belief, noise).worst[1] <= UNCERTAINTY:
            return spec
    return DEFAULT
