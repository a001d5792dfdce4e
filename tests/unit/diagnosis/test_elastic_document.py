"""What the document of an elastic machine says beside its causes: forces, what is left, limits, a cut."""

from __future__ import annotations

import itertools
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from unit.likelihood.chain_plant import ChainPlant

from invid.diagnosis.unknown_forces.elastic import diagnose_elastic
from invid.identification.begun import begin_elastic
from invid.model.diagnosis_document import Diagnosis, Verdict, diagnosis_from_json, diagnosis_to_json
from invid.numerics import budget
from invid.recording.model import Recording

GAP = 3e-3


def cooling(recording: Recording, axis: int, size: float) -> Recording:
    """The recording with a torque at a motor that the drive does not give and that fades within a record."""
    experiments = []
    for e in recording.experiments:
        torque = e.torque.copy()
        torque[:, axis] += size * np.exp(-(e.time - e.time[0]) / 3.0)
        experiments.append(replace(e, torque=torque))
    return replace(recording, experiments=tuple(experiments))


@pytest.fixture(scope="module")
def with_play() -> Diagnosis:
    plant = ChainPlant(gaps={0: GAP})
    return diagnose_elastic(begin_elastic(plant.recording(41), plant.sizes))


@pytest.mark.campaign
def test_forces_stand_at_every_place_and_play_takes_most_of_those_in_its_spring(with_play: Diagnosis) -> None:
    places = [(f.axis, f.element, f.other_axis) for f in with_play.forces]
    assert (
        len(set(places)) == len(places) == 2 + 3 + 3 + 1
    )  # motors, inner masses, springs, one pair of loads
    before = {p: f.before for p, f in zip(places, with_play.forces, strict=True)}
    after = {p: f.after for p, f in zip(places, with_play.forces, strict=True)}
    inner = [p for p in places if p[1] != "mass 1"]
    assert max(after[p] for p in inner) < 0.1 * max(before[p] for p in inner)


@pytest.mark.campaign
def test_what_is_found_is_never_ruled_out_and_every_other_cause_has_a_limit_or_a_reason(
    with_play: Diagnosis,
) -> None:
    found = {(x.cause, x.axis, x.element) for f in with_play.findings for x in (f, *f.alternatives)}
    said = [(r.cause, r.axis, r.element) for r in with_play.ruled_out]
    assert ("backlash", "A1", "spring 1") in found
    assert not found & set(said)
    assert ("backlash", "A2", "spring 1") in said
    for r in with_play.ruled_out:
        assert (r.limit is None) is (r.why is not None)
        assert r.limit is None or r.limit > 0.0
    other = [r.limit for r in with_play.ruled_out if r.cause == "backlash" and r.axis == "A2"]
    assert any(limit is not None for limit in other)


@pytest.mark.campaign
def test_the_document_is_read_as_it_was_written(with_play: Diagnosis) -> None:
    written = json.dumps(diagnosis_to_json(with_play))
    assert json.dumps(diagnosis_to_json(diagnosis_from_json(json.loads(written)))) == written


@pytest.mark.campaign
def test_a_torque_that_fades_is_left_on_its_axis_and_goes_with_time() -> None:
    plant = ChainPlant()
    found = diagnose_elastic(begin_elastic(cooling(plant.recording(42), 1, 2.0), plant.sizes))
    assert found.verdict in (Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED)
    assert found.unexplained is not None
    assert found.unexplained.axis == "A2"
    assert "time-dependent" in found.unexplained.character


@pytest.mark.parametrize("ticks", [3, pytest.param(60, marks=pytest.mark.campaign)])
def test_a_search_that_its_budget_ends_says_so_and_calls_nothing_consistent(ticks: int) -> None:
    plant, count = ChainPlant(gaps={0: GAP}), itertools.count()
    with budget.use_budget(budget.Budget(float(ticks), lambda: float(next(count)))):
        found = diagnose_elastic(begin_elastic(plant.recording(41), plant.sizes))
        assert "further causes" in budget.left_out()
    assert found.details["cut_short"]
    assert found.verdict in (Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED)
    assert all(f.confidence <= 0.89 for f in found.findings)
    assert found.ruled_out == ()
