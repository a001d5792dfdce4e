"""A new run against the mean of accepted ones: smaller changes found, none averaged away, no more alarms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm
from test_joint_test import NAMES, SIZE, VALUES, changed, covariance, drawn, model_of

from invid.comparison.baseline import MOST, pool_agreeing, pool_models, repeatability
from invid.comparison.compare import compare
from invid.model.document import EffectTerm, Estimate, Model

STD = 2e-3 * np.abs(VALUES)
ALONE = np.diag(STD**2)
"""Errors that do not go together: the mean of runs is all that helps."""
J = NAMES.index("A2.damper.1")


def moved_by(size: float) -> np.ndarray:
    truth = VALUES.copy()
    truth[J] += size
    return truth


def found_in(rng: np.random.Generator, shift: float, before: int, after: int, tries: int = 40) -> float:
    found = 0
    for _ in range(tries):
        old = [drawn(rng, ALONE) for _ in range(before)]
        new = [drawn(rng, ALONE, moved_by(shift * STD[J])) for _ in range(after)]
        named = changed(old[-1], new[-1], before=old[:-1], after=new[:-1])
        assert set(named) <= {NAMES[J]} or len(named) <= 2
        found += NAMES[J] in named
    return found / tries


@pytest.mark.campaign
def test_the_mean_of_runs_finds_a_change_as_often_as_the_normal_distribution_says() -> None:
    rng = np.random.default_rng(31)
    # 80 % of 1 % over all parameters, two-sided; one that is off beside it does not matter here.
    threshold = norm.isf(0.8 * 0.01 / (2 * SIZE))
    for before, after in ((1, 1), (6, 1), (6, 4)):
        shift = 4.5
        expected = norm.sf(threshold - shift / np.sqrt(1 / before + 1 / after))
        found = found_in(rng, shift, before, after)
        # Four standard errors, and one in twenty runs that is not averaged.
        assert abs(found - expected) < 4 * np.sqrt(max(expected * (1 - expected), 0.01) / 40) + 0.05


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


@pytest.mark.campaign
def test_averaging_raises_no_more_false_alarms_also_where_the_cell_repeats_worse_or_drifts() -> None:
    rng = np.random.default_rng(33)
    alarms = {"worse": 0, "drifting": 0}
    for _ in range(30):
        matrix = covariance(rng)
        worse = [drawn(rng, matrix, scale=2.0) for _ in range(7)]
        walk = np.cumsum(rng.multivariate_normal(np.zeros(SIZE), 0.3**2 * matrix, size=7), axis=0)
        drifting = [drawn(rng, matrix, VALUES + step) for step in walk]
        for name, runs in (("worse", worse), ("drifting", drifting)):
            alarms[name] += bool(changed(runs[-2], runs[-1], history=runs, before=runs[:-2]))
    # Of 30: more than 4 has probability 0.03 % at 2 %.
    assert max(alarms.values()) <= 4, alarms


def test_a_run_from_before_a_change_is_not_averaged() -> None:
    rng = np.random.default_rng(34)
    heavier = moved_by(8 * STD[J])
    light = [drawn(rng, ALONE) for _ in range(4)]
    heavy = [drawn(rng, ALONE, heavier) for _ in range(3)]
    assert pool_agreeing(heavy[-1], [*light, *heavy[:-1]], 1.0) == heavy
    result = compare(heavy[-1], drawn(rng, ALONE, heavier), before=[*light, *heavy[:-1]])
    assert result.runs == (3, 1)
    assert "means: the old values of 3 runs" in result.sentences[-1]


def test_a_run_whose_friction_differs_is_not_averaged_and_one_without_it_neither() -> None:
    def rubbing(torque: float) -> Model:
        value = {"torque": Estimate(torque, 0.01, "N·m")}
        return model_of(VALUES, ALONE).extended(EffectTerm("coulomb_friction", "A1", value, "mass 1"))

    same = pool_agreeing(rubbing(1.0), [rubbing(1.01)], 1.0)
    assert len(same) == 2
    mean = pool_models(same).effects[0].parameters["torque"]
    assert mean.value == pytest.approx(1.005)
    assert mean.std == pytest.approx(0.01 / np.sqrt(2))
    assert len(pool_agreeing(rubbing(1.0), [rubbing(1.2)], 1.0)) == 1
    assert len(pool_agreeing(rubbing(1.0), [model_of(VALUES, ALONE)], 1.0)) == 1


def test_no_more_than_a_few_runs_are_averaged_and_the_sharper_one_weighs_more() -> None:
    rng = np.random.default_rng(35)
    many = [drawn(rng, ALONE) for _ in range(3 * MOST)]
    assert len(pool_agreeing(many[-1], many[:-1], 10.0)) == MOST
    rough, sharp = model_of(VALUES * 1.01, 9 * ALONE), model_of(VALUES, ALONE)
    mean = pool_models([rough, sharp])
    # Weights 1 : 9, by the variances.
    assert mean.chains.masses[0][0] == pytest.approx(VALUES[0] * 1.001)
    assert mean.std.masses[0][0] == pytest.approx(STD[0] * np.sqrt((0.1 * 3) ** 2 + 0.9**2))
    assert mean.covariance is not None
    assert np.sqrt(mean.covariance[0, 0]) == pytest.approx(mean.std.masses[0][0])


def test_a_cell_that_repeats_better_than_its_fits_say_is_believed_after_enough_runs() -> None:
    rng = np.random.default_rng(36)
    matrix = covariance(rng)
    quiet = [drawn(rng, matrix, scale=0.6) for _ in range(12)]
    assert repeatability(quiet).factor == pytest.approx(0.6, abs=0.15)
    assert repeatability(quiet[:2]).factor == 1.0


def test_runs_of_one_state_are_not_torn_apart_because_the_cell_repeats_better_than_its_fits_say() -> None:
    rng = np.random.default_rng(37)
    quiet = [drawn(rng, ALONE, scale=0.6) for _ in range(10)]
    # Off by 6.2 deviations of this cell's own scatter, by less than what its fits would call another state.
    odd = VALUES.copy()
    odd[J] += 6.2 * 0.6 * STD[J]
    quiet.append(model_of(odd, ALONE))
    new = drawn(rng, ALONE, scale=0.6)
    factor = repeatability(quiet).factor
    assert factor < 0.75
    assert len(pool_agreeing(quiet[-1], quiet[5:-1], factor)) == 1
    result = compare(quiet[-1], new, history=[*quiet, new], before=quiet[5:-1])
    assert result.runs == (6, 1)
    assert all(p.status != "changed" for p in result.parameters)
