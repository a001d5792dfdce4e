"""Where the holds of a cell run, told from the viscous friction of all axes together."""

from __future__ import annotations

import numpy as np

from invid.likelihood.nuisance.hold_timing import are_holds_sampled


def test_friction_short_on_two_axes_speaks_for_the_third_that_alone_tells_nothing() -> None:
    unclear = (0.05, 0.1, 0.1)
    assert not are_holds_sampled([unclear])
    assert are_holds_sampled([unclear, (0.0, 0.01, 0.1), (0.01, 0.01, 0.1)])


def test_friction_as_large_as_holds_inside_the_drives_make_it_leaves_all_axes_open() -> None:
    assert not are_holds_sampled([(0.1, 0.01, 0.1), (0.12, 0.01, 0.1), (0.06, 0.01, 0.1)])


def test_negative_friction_counts_as_none_and_is_no_further_evidence() -> None:
    # Something else wears friction's mask there: it must not decide for an axis that it says nothing about.
    assert not are_holds_sampled([(-1.0, 0.1, 0.1), (0.05, 0.1, 0.1)])


def test_holds_inside_the_drives_are_wrongly_closed_no_more_than_once_in_740() -> None:
    rng = np.random.default_rng(0)
    # The worst case: every drive's loop runs but twice a sample.
    draws = rng.normal(0.5, 0.1, (20_000, 3))
    wrong = sum(are_holds_sampled([(f, 0.1, 1.0) for f in draw]) for draw in draws)
    assert wrong < 20_000 / 740 * 1.6  # three standard deviations of the count


def test_no_axis_is_no_evidence() -> None:
    assert not are_holds_sampled([])
