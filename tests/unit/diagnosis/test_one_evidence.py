"""A cause is weighed in one way, by finished fits; what is fitted is said, whatever the time left."""

from functools import cache

import pytest
from hidden.generator import make

import invid
from invid.diagnosis.unknown_forces.machine_search import search_elastic
from invid.identification.search_start import begin_elastic
from invid.model.diagnosis_document import Diagnosis, Verdict
from invid.numerics.budget import Budget, Progress, stop, use_budget
from invid.recording.model import Recording

STIFFNESS = 200.0


@cache
def tied() -> Recording:
    """Two axes with a spring between their loads."""
    size = {"stiffness": STIFFNESS}
    return make("coupling_stiffness", (0, 2), size, seed=500901, motors=2, masses=(2, 2))[0]


def stopped_at(stage: str) -> Diagnosis:
    """The diagnosis of a search that somebody ends as soon as it comes to a stage."""

    def tell(progress: Progress) -> None:
        if progress.stage == stage:
            stop()

    return invid.diagnose(tied(), progress=tell)


@pytest.mark.campaign
def test_identify_says_the_spring_between_loads_that_it_fitted() -> None:
    model = invid.identify(tied())
    (spring,) = [e for e in model.effects if e.cause == "coupling_stiffness"]
    assert {spring.axis, spring.other_axis} == {*tied().axes}
    assert spring.parameters["stiffness"].value == pytest.approx(STIFFNESS, rel=0.02)


def test_what_is_fitted_and_not_weighed_explains_nothing_and_is_said() -> None:
    result = stopped_at("weighing each cause")
    assert result.verdict is not Verdict.EXPLAINED
    assert "coupling_stiffness" in {f.cause for f in result.findings}
    assert all(f.confidence <= 0.5 for f in result.findings)
    assert any("weighed" in w for w in result.warnings)


@pytest.mark.campaign
def test_a_spring_between_loads_is_weighed_like_any_cause() -> None:
    result = invid.diagnose(tied())
    (spring,) = [f for f in result.findings if f.cause == "coupling_stiffness"]
    assert result.verdict is Verdict.EXPLAINED
    assert spring.confidence > 0.9
    assert spring.parameters["stiffness"].value == pytest.approx(STIFFNESS, rel=0.02)


@pytest.mark.campaign
def test_a_search_that_has_no_time_for_its_first_cause_still_says_what_is_left_where() -> None:
    """Motion behind the motors had never been worked out: it ended in an internal error."""
    free_play = make("backlash", (0, 1), {"gap": 4e-3}, seed=500902, motors=1, masses=(2,))[0]
    seconds, each = 0.0, 0.0

    def clock() -> float:
        nonlocal seconds
        seconds += each
        return seconds

    def tell(progress: Progress) -> None:
        nonlocal seconds, each
        seconds = 70.0 if progress.stage == "looking for causes" else seconds  # 60 of 100 were its share
        each = 0.2 if progress.stage == "what is left" else each

    with use_budget(Budget(100.0, clock, tell)):
        found = search_elastic(begin_elastic(free_play, (2,)))
    assert found.is_cut_short
    assert not found.pursued.end.hypothesis.laws
    assert any(f.is_sure for f in found.forces_named)
