"""Records kept out show what those fitted hardly do: another amplitude, another load."""

from dataclasses import replace

import pytest

from hidden.generator import make
from invid.diagnosis.diagnose import diagnose
from invid.model.diagnosis_document import Verdict


def test_what_only_records_kept_out_show_is_unexplained_and_not_consistent() -> None:
    recording, _ = make("cubic_stiffness", seed=0, motors=1, target_db=-8, validate_level=3.0, moves=False)
    found = diagnose(recording)
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.unexplained is not None
    assert "the records kept out miss" in found.unexplained.sentence


def test_a_mechanism_outside_the_catalogue_at_three_times_the_amplitude_is_not_named() -> None:
    recording, _ = make(
        "power_drag", seed=3, motors=1, masses=(2,), target_db=-8, validate_level=3.0, moves=False, periods=2
    )
    found = diagnose(recording)
    assert found.verdict in (Verdict.UNEXPLAINED, Verdict.PARTLY_EXPLAINED)
    assert all(f.confidence < 0.9 for f in found.findings)


def test_a_load_that_changed_between_the_fitted_and_the_kept_out_records_is_not_named_from_those() -> None:
    """Validation data never enters a fit, and only it knows the other load: it is said that something is
    left."""
    plain = {"seed": 1, "motors": 1, "masses": (2,), "moves": False, "periods": 2, "from_rest": False}
    times = [(e.time[0], e.time[-1]) for e in make(None, **plain)[0].experiments]
    between = 0.5 * (times[-2][1] + times[-1][0])
    recording, _ = make("payload_change", (0, 2), {"mass": 7.8, "time": between}, **plain)
    found = diagnose(recording)
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.unexplained is not None
    assert "the records kept out miss" in found.unexplained.sentence


def test_a_load_that_changes_within_every_record_is_found_at_its_instant() -> None:
    """A clock that starts anew in every experiment: a period's lines show the mean of what the load was."""
    plain = {"seed": 2, "motors": 1, "masses": (2,), "moves": False, "periods": 4}
    first = make(None, **plain)[0].experiments[0]
    when = float(first.time[0] + 0.6 * (first.time[-1] - first.time[0]))
    recording, _ = make("payload_change", (0, 2), {"mass": 0.4, "time": when}, **plain)
    alone = replace(recording, experiments=recording.experiments[:1])
    (named,) = diagnose(alone).findings
    assert named.effect.cause == "payload_change"
    assert named.effect.value("mass") == pytest.approx(0.4, rel=0.02)
    assert named.effect.value("time") == pytest.approx(when, abs=0.02)


def test_a_load_that_changes_is_found_in_times_that_count_from_1970() -> None:
    recording, truth = make(
        "payload_change", seed=3, motors=1, masses=(2,), target_db=25, moves=False, periods=2, from_rest=False
    )
    epoch = 1.7e9
    later = tuple(replace(e, time=e.time + epoch) for e in recording.experiments)
    (named,) = diagnose(replace(recording, experiments=later)).findings
    assert named.effect.cause == "payload_change"
    assert named.effect.value("mass") == pytest.approx(truth.effects[0].parameters["mass"], rel=0.05)
    time = named.effect.parameters["time"]
    assert time.std is not None
    assert abs(time.value - epoch - truth.effects[0].parameters["time"]) < 3 * time.std < 30.0
