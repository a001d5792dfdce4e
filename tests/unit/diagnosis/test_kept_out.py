"""What is kept out of every fit, by what a recording holds."""

from dataclasses import replace

import pytest
from hidden.generator import make

from invid.errors import InputError, NotIdentifiableError
from invid.identification.kept_out import records_of
from invid.recording.model import Experiment, Recording, Role


@pytest.fixture(scope="module")
def recording() -> Recording:
    return make(None, seed=330201, motors=1, masses=(2,), moves=False, from_rest=False, periods=3)[0]


def one_step(e: Experiment) -> float:
    return float(e.time[1] - e.time[0])


def _rows(e: Experiment, rows: slice) -> Experiment:
    cut = {name: getattr(e, name)[rows] for name in ("time", "position", "torque")}
    return replace(e, torque_demand=None, status=None, **cut)


def test_validation_records_are_kept_out_without_a_word(recording: Recording) -> None:
    split = records_of(recording)
    roles = [{e.key for e in recording.with_role(role)} for role in (Role.IDENTIFY, Role.VALIDATE)]
    assert [{r.key for r in part} for part in (split.fitted, split.kept)] == roles
    assert not (*split.warnings, *split.stopgap)


def test_of_a_climb_and_its_block_the_climb_is_kept_out(recording: Recording) -> None:
    """The block was, and a short check of an unchanged axis with much friction could not tell."""
    block = recording.with_role(Role.IDENTIFY)[0]
    weak = {"position": 0.1 * block.position, "torque": 0.1 * block.torque}
    climb = replace(block, key="climb", torque_demand=None, **weak)
    split = records_of(replace(recording, experiments=(climb, block)))
    assert [r.key for r in split.kept] == ["climb"]


def test_of_one_record_its_last_period_is_kept_out(recording: Recording) -> None:
    one = recording.with_role(Role.IDENTIFY)[0]
    split = records_of(replace(recording, experiments=(one,)))
    (fitted,), (kept,) = split.fitted, split.kept
    assert (fitted.periods, kept.periods) == (one.periods - 1, 1)
    assert abs(kept.start - fitted.start - fitted.span) < 1.5 * one_step(one)
    assert any("the last period of each experiment" in w for w in split.stopgap)


def test_of_one_period_every_fifth_line_is_kept_out(recording: Recording) -> None:
    one = recording.with_role(Role.IDENTIFY)[0]
    split = records_of(replace(recording, experiments=(_rows(one, slice(0, one.period_samples)),)))
    (fitted,), (kept,) = split.fitted, split.kept
    assert set(fitted.used) & set(kept.used) <= {0}
    assert 3.0 < fitted.used.size / kept.used.size < 5.0
    assert any("every fifth line" in w for w in split.stopgap)


def test_records_without_anything_to_fit_are_refused_in_words(recording: Recording) -> None:
    only = tuple(replace(e, role=Role.VALIDATE) for e in recording.experiments)
    with pytest.raises(InputError, match="role 'identify'"):
        records_of(replace(recording, experiments=only))
    short = tuple(_rows(e, slice(0, 80)) for e in recording.experiments)
    with pytest.raises(NotIdentifiableError, match="record for longer"):
        records_of(replace(recording, experiments=short))
