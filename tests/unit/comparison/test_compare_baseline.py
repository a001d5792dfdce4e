"""A new run against the mean of accepted ones: smaller changes found, none averaged away, no more alarms."""

from __future__ import annotations

import numpy as np
import pytest
from stated_models import term
from test_joint_test import NAMES, VALUES, believed, covariance, drawn

from invid.comparison.baseline import pool_agreeing
from invid.comparison.compare import compare
from invid.comparison.numbers import mean_model
from invid.model.document import Model

STD = 2e-3 * np.abs(VALUES)
ALONE = np.diag(STD**2)
"""Errors that do not go together: the mean of runs is all that helps."""
J = NAMES.index("A2.damper.1")


def moved_by(size: float) -> np.ndarray:
    truth = VALUES.copy()
    truth[J] += size
    return truth


def test_a_change_of_the_size_called_detectable_is_found_nine_times_in_ten() -> None:
    rng = np.random.default_rng(32)
    matrix = covariance(rng, correlation=0.97)
    told = compare(drawn(rng, matrix), drawn(rng, matrix))
    size = next(p for p in told.parameters if p.name == NAMES[J])
    assert size.detectable is not None
    shift = size.detectable * size.scale
    # Known to better than its own deviation, as its error goes along with others'.
    assert shift < 3 * np.sqrt(2 * matrix[J, J])
    found = 0
    for _ in range(120):
        result = compare(drawn(rng, matrix), drawn(rng, matrix, moved_by(shift)))
        found += any(p.name == NAMES[J] and (p.status == "changed" or p.rivals) for p in result.parameters)
    assert 0.80 <= found / 120 <= 0.98


def test_a_run_whose_friction_differs_is_not_averaged_and_one_without_it_neither() -> None:
    def rubbing(torque: float) -> Model:
        return believed(VALUES, ALONE).extended(
            term("coulomb_friction", "A1", "mass 1", torque=(torque, 0.01))
        )

    same = pool_agreeing(rubbing(1.0), [rubbing(1.01)], 1.0)
    assert len(same) == 2
    mean = mean_model(same).effects[0].parameters["torque"]
    assert mean.value == pytest.approx(1.005)
    assert mean.std == pytest.approx(0.01 / np.sqrt(2))
    assert len(pool_agreeing(rubbing(1.0), [rubbing(1.2)], 1.0)) == 1
    assert len(pool_agreeing(rubbing(1.0), [believed(VALUES, ALONE)], 1.0)) == 1
