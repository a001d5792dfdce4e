"""Time left and what is weighed, through the whole analysis: by what it says of itself, else by the clock."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from typing import Any

import pytest

from invid.numerics.budget import Found
from invid_service.jobs.analysis_progress import BEGINS, ENDS, STAGES, AnalysisProgress
from invid_service.jobs.line import Line
from invid_service.jobs.measurement import Pace


@dataclass
class Weighing:
    """As ``invid.numerics.budget.Progress``."""

    stage: str
    axis: str | None = None
    cause: str | None = None
    fraction: float = 0.0
    seconds_left: float | None = None
    found: tuple[Found, ...] = ()

    def __str__(self) -> str:
        return f"{self.stage} {self.cause}, {self.axis}"


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def analysis() -> tuple[AnalysisProgress, Clock, list[dict[str, Any]]]:
    told: list[dict[str, Any]] = []
    clock = Clock()

    return AnalysisProgress(lambda p, **_: told.append(p.model_dump()), 40.0, 600.0, clock=clock), clock, told


Analysis = tuple[AnalysisProgress, Clock, list[dict[str, Any]]]


def test_an_analysis_that_says_nothing_moves_on_by_the_clock(analysis: Analysis) -> None:
    progress, clock, told = analysis
    progress.begin("identifying")
    clock.now = 5.0
    progress.say()
    progress.begin("diagnosing")
    for clock.now in (20.0, 30.0, 60.0):
        progress.say()
    fractions = [t["fraction"] for t in told]
    assert fractions == sorted(fractions)
    assert fractions[0] >= BEGINS
    assert fractions[-1] < ENDS
    assert [t["eta_s"] for t in told] == pytest.approx([40, 35, 35, 20, 10, None])


def test_what_is_weighed_is_told_with_cause_and_axis_and_no_time_but_that_of_earlier_runs(
    analysis: Analysis,
) -> None:
    progress, clock, told = analysis
    progress.begin("diagnosing")
    clock.now = 10.0
    progress.weigh(Weighing("weighing", "A2", "backlash", 0.5, 12.0))
    assert told[-1]["phase"] == "weighing backlash, A2"
    assert (told[-1]["axis"], told[-1]["cause"]) == ("A2", "backlash")
    assert told[-1]["eta_s"] == pytest.approx(30.0)
    clock.now = 14.0
    progress.say()
    assert told[-1]["eta_s"] == pytest.approx(26.0)
    progress.weigh(Weighing("weighing", "A1", "cogging", 0.3))
    assert told[-1]["fraction"] >= told[-2]["fraction"]


def test_an_analysis_that_takes_longer_than_ever_says_when_it_ends_at_the_latest(analysis: Analysis) -> None:
    progress, clock, told = analysis
    progress.begin("diagnosing")
    clock.now = 100.0
    progress.say()
    assert (told[-1]["eta_s"], told[-1]["most_s"]) == (None, pytest.approx(500.0))
    clock.now = 700.0
    progress.say()
    assert told[-1]["most_s"] == 0.0


@pytest.mark.parametrize(("identified", "left"), [(4.0, 36.0), (35.0, 65.0)])
def test_a_first_analysis_is_told_by_what_such_ones_take_and_by_its_own_first_stage(
    identified: float, left: float
) -> None:
    told: list[dict[str, Any]] = []
    clock = Clock()
    first = AnalysisProgress(lambda p, **_: told.append(p.model_dump()), None, 600.0, clock=clock)
    first.begin("identifying")
    assert told[-1]["eta_s"] == pytest.approx(40.0)
    clock.now = identified
    first.begin("diagnosing")  # about a third of the work lies behind
    assert told[-1]["eta_s"] == pytest.approx(left)
    first.weigh(Weighing("weighing", "A1", "cogging", 0.5, 480.0))
    assert told[-1]["eta_s"] == pytest.approx(left), "what the search says of its own steps is no measure"
    clock.now += 0.5 * left
    first.begin("writing the report")
    assert told[-1]["eta_s"] < 0.1 * clock.now, "nearly done"


def test_time_left_of_a_motion_follows_the_pace_that_it_has(analysis: Analysis) -> None:
    _, clock, _ = analysis
    pace = Pace(clock)
    assert pace.left(40.0) == pytest.approx(40.0)
    clock.now = 1.0
    assert pace.left(30.0) == pytest.approx(3.0)  # ten seconds of the plan in one: a simulated cell
    clock.now = 5.0
    assert pace.left(36.0) == pytest.approx(45.0)  # a computer that is behind


def test_what_is_found_is_told_while_the_search_goes_on(analysis: Analysis) -> None:
    progress, _, told = analysis
    progress.begin("diagnosing")
    found = Found("coulomb_friction", "A1", element="mass 1")
    progress.weigh(Weighing("weighing", "A2", "backlash", 0.5, 12.0, (found,)))
    assert told[-1]["found"] == (
        {"cause": "coulomb_friction", "axis": "A1", "other_axis": None, "element": "mass 1"},
    )
    assert "found" not in told[-1]["phase"], "the phase is what it does, and short"


def test_a_stage_that_begins_is_told_however_short_the_one_before_was() -> None:
    line = Line(io.BytesIO(), sink := io.BytesIO())
    progress = AnalysisProgress(line.progress, None, 600.0)
    for stage in STAGES:
        progress.begin(stage)
        progress.weigh(Weighing("weighing", "A1", "backlash", 0.5))
    line.close()
    told = [json.loads(row)["phase"] for row in sink.getvalue().splitlines()]
    assert told == list(STAGES)  # and what follows within a fifth of a second is not
