"""Departures of cells from their own populations: few false ones, and true ones soon."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.comparison.bench_fleet import SETTLED, false_alarms, found_within, simulate
from invid.comparison.fleet import FleetHistory, departures, fleet_history
from invid.errors import InputError
from invid.model.chains import case_study
from invid.model.document import ChainStd, EffectTerm, Estimate, Model


def test_a_calm_fleet_raises_one_false_alarm_in_a_thousand_cell_weeks_at_most() -> None:
    calm, *_ = simulate(400, 52, 24, 0.0, np.random.default_rng(11))
    # 20,000 cell-weeks: 20 alarms are the bar, a Poisson count of them exceeds 31 with 1 %.
    assert 1000 * false_alarms(calm) < 31 / 20


def test_a_change_of_five_standard_deviations_is_told_within_two_runs() -> None:
    history, when, which = simulate(400, 52, 24, 5.0, np.random.default_rng(12))
    told = found_within(history, when, which, 2)[when >= SETTLED]
    assert np.nanmean(told) > 0.95


def test_smaller_changes_are_told_later_and_none_is_told_before_it_came() -> None:
    history, when, which = simulate(300, 52, 12, 3.0, np.random.default_rng(13))
    settled = (when >= SETTLED) & (when < 40)
    two, eight = (found_within(history, when, which, n)[settled] for n in (2, 8))
    assert 0.2 < np.nanmean(two) < np.nanmean(eight)
    early = [d for d in departures(history) if d.seen < when[int(d.cell[1:])]]
    assert len(early) < 300 * 52 * 2e-3


def test_a_departure_says_where_when_and_how_much() -> None:
    rng = np.random.default_rng(3)
    std = np.full((30, 50, 4), 0.5)
    value = 100.0 + 0.5 * rng.standard_normal(std.shape)
    value[20:, 7, 2] -= 6.0
    names = ("A1.mass.1", "A1.spring.1", "A2.spring.1", "A2.mass.1")
    history = FleetHistory(tuple(f"cell {c}" for c in range(50)), names, value, std)
    (found,) = [d for d in departures(history) if d.cell == "cell 7"]
    assert (found.parameter, found.since) == ("A2.spring.1", 20)
    assert found.seen in (20, 21)
    assert found.after - found.before == pytest.approx(-6.0, abs=3 * found.std)
    assert found.p < 1e-3
    assert found.sentence.startswith("cell 7: A2.spring.1 left its own population in run 21: ")


def test_an_alarm_is_raised_once_and_the_way_back_is_another() -> None:
    rng = np.random.default_rng(4)
    std = np.full((40, 30, 3), 1.0)
    value = rng.standard_normal(std.shape)
    value[15:30, 0, 0] += 10.0
    history = FleetHistory(tuple(map(str, range(30))), ("a", "b", "c"), value, std)
    assert [(d.parameter, d.since) for d in departures(history) if d.cell == "0"] == [("a", 15), ("a", 30)]


def test_one_cell_alone_is_judged_by_its_own_scatter() -> None:
    rng = np.random.default_rng(5)
    std = np.full((40, 1, 2), 1.0)
    value = 3.0 * rng.standard_normal(std.shape)  # three times what its fits state
    assert departures(FleetHistory(("one",), ("a", "b"), value, std)) == ()
    value[30:, 0, 1] += 30.0
    found = departures(FleetHistory(("one",), ("a", "b"), value, std))
    assert [(d.parameter, d.since) for d in found] == [("b", 30)]


def model(rng: np.random.Generator, gap: float | None) -> Model:
    chains = case_study(damping_ratio=0.01)

    def noisy(values: tuple[np.ndarray, ...]) -> tuple[np.ndarray, ...]:
        return tuple(v * (1 + 1e-3 * rng.standard_normal(v.shape)) for v in values)

    std = ChainStd(
        tuple(1e-3 * m for m in chains.masses),
        tuple(1e-3 * k for k in chains.springs),
        tuple(1e-3 * d for d in chains.dampers),
        np.full((3, 3), np.nan),
        np.full(3, np.nan),
    )
    made = Model(
        "r", "refined", replace(chains, masses=noisy(chains.masses), springs=noisy(chains.springs)), std
    )
    if gap is None:
        return made
    size = Estimate(gap + 1e-5 * rng.standard_normal(), 1e-5, "rad")
    return made.extended(EffectTerm("backlash", "A2", {"gap": size}, "spring 1"))


def test_a_cause_that_comes_is_a_departure_and_one_that_is_barely_named_now_and_then_is_none() -> None:
    rng = np.random.default_rng(6)
    fleet = {f"cell {c}": [model(rng, None) for _ in range(12)] for c in range(15)}
    fleet["worn"] = [model(rng, 6e-4 if t >= 9 else None) for t in range(12)]
    fleet["marginal"] = [model(rng, 5e-5 if t % 3 == 0 else None) for t in range(12)]
    found = [(d.cell, d.parameter, d.since) for d in departures(fleet_history(fleet))]
    assert found == [("worn", "A2.backlash.spring 1", 9)]


def test_cells_with_other_numbers_of_runs_and_parameters_stand_together() -> None:
    rng = np.random.default_rng(7)
    fleet = {"long": [model(rng, None) for _ in range(9)], "short": [model(rng, None)], "none": []}
    history = fleet_history(fleet)
    assert history.value.shape[:2] == (9, 3)
    assert np.isnan(history.value[1:, 1]).all()
    assert departures(history) == ()
    assert departures(fleet_history({})) == ()


def test_shapes_that_do_not_match_are_refused() -> None:
    with pytest.raises(InputError, match="both need"):
        FleetHistory(("a",), ("p",), np.zeros((3, 1, 2)), np.zeros((3, 1, 1)))
