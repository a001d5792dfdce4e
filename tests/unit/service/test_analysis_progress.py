"""Time left and what is weighed, through the whole analysis: by what it says of itself, else by the clock."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import pytest

from invid.numerics.budget import Found
from invid_service.jobs.analysis_progress import BEGINS, ENDS, AnalysisProgress


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

    return AnalysisProgress(lambda p, **_: told.append(asdict(p)), 40.0, 600.0, clock=clock), clock, told


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


def test_what_is_found_is_told_while_the_search_goes_on(analysis: Analysis) -> None:
    progress, _, told = analysis
    progress.begin("diagnosing")
    found = Found("coulomb_friction", "A1", element="mass 1")
    progress.weigh(Weighing("weighing", "A2", "backlash", 0.5, 12.0, (found,)))
    assert told[-1]["found"] == (
        {"cause": "coulomb_friction", "axis": "A1", "other_axis": None, "element": "mass 1"},
    )
    assert "found" not in told[-1]["phase"], "the phase is what it does, and short"
