"""What a diagnosis says that the recording would have shown, against causes of that size in the plant."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hidden.generator import make

import invid
from invid.model.diagnosis_document import RuledOut, diagnosis_to_json, load_diagnosis


def limit(diagnosis: invid.Diagnosis, cause: str, element: str | None) -> RuledOut:
    (found,) = (r for r in diagnosis.ruled_out if (r.cause, r.element) == (cause, element))
    return found


def quiet(seed: int) -> dict:
    return {"seed": seed, "masses": (2,), "noise": 0.003, "drive": "smooth"}


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("cause", "element", "parameter"),
    [
        ("coulomb_friction", "mass 1", "torque"),
        ("backlash", "spring 1", "gap"),
        ("viscous_friction", "mass 1", "coefficient"),  # a hold inside the drive may make the like of it
        ("torque_lag", None, "time_constant"),  # a time offset takes up most of it
    ],
)
def test_a_cause_above_its_limit_is_found_and_one_at_half_of_it_is_not(
    cause: str, element: str | None, parameter: str
) -> None:
    found = {1.3: 0, 0.5: 0}
    for seed in (651, 652, 653, 654):
        null = invid.diagnose(make(None, **quiet(seed))[0])
        assert null.findings == ()
        most = limit(null, cause, element)
        assert most.limit is not None
        for factor in found:
            size = {parameter: factor * most.limit}
            recording, _ = make(cause, (0, 1), size, **quiet(seed))
            found[factor] += [f.cause for f in invid.diagnose(recording).findings] == [cause]
    assert found[1.3] >= 3
    assert found[0.5] <= 1


def test_it_says_of_every_cause_and_place_a_limit_or_why_there_is_none_and_is_kept(tmp_path: Path) -> None:
    recording, _ = make(None, **quiet(655))
    found = invid.diagnose(recording)
    places = {(r.cause, r.axis, r.element, r.other_axis) for r in found.ruled_out}
    assert len(places) == len(found.ruled_out) > 15
    for r in found.ruled_out:
        assert (r.limit is None) is (r.why is not None)
        assert r.limit is None or r.limit > 0.0
    assert sorted(f.element for f in found.forces) == ["mass 1", "mass 2", "spring 1"]
    friction = limit(found, "coulomb_friction", "mass 1")
    assert friction.sentence.startswith("No dry friction above ")
    assert friction.sentence.endswith(f" N·m on {friction.axis} at the motor.")
    found.save(tmp_path / "diagnosis.json")
    assert load_diagnosis(tmp_path / "diagnosis.json").ruled_out == found.ruled_out
    keys = {"cause", "axis", "element", "other_axis", "parameter", "limit", "unit", "why"}
    assert keys <= set(diagnosis_to_json(found)["ruled_out"][0])


@pytest.mark.campaign
def test_more_noise_hides_more() -> None:
    low, high = (invid.diagnose(make(None, **{**quiet(656), "noise": noise})[0]) for noise in (0.001, 0.01))
    for cause, element in (("coulomb_friction", "mass 1"), ("backlash", "spring 1")):
        quieter, louder = (limit(d, cause, element).limit for d in (low, high))
        assert quieter is not None
        assert louder is not None
        assert louder > 3.0 * quieter


def test_free_play_of_a_gear_that_a_weight_holds_to_one_side_could_not_have_been_seen() -> None:
    recording, _ = make(None, **quiet(657))
    largest = max(float(np.abs(e.torque).max()) for e in recording.experiments)
    hanging = replace(
        recording,
        experiments=tuple(replace(e, torque=e.torque + 20.0 * largest) for e in recording.experiments),
    )
    found = invid.diagnose(hanging)
    play = limit(found, "backlash", "spring 1")
    assert (play.limit, play.why) == (None, "it was never unloaded")
    assert "could not have been seen: it was never unloaded" in play.sentence
    assert limit(found, "coulomb_friction", "mass 1").limit is not None


@pytest.mark.campaign
def test_where_something_is_left_without_a_name_nothing_is_ruled_out() -> None:
    recording, _ = make("power_drag", target_db=25.0, **quiet(301))
    found = invid.diagnose(recording)
    assert [f.cause for f in found.findings] == ["empirical_law"]
    assert found.ruled_out == ()
