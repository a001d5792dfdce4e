"""What is kept out of a fit: the first row of the table that holds, and what a look may ask for instead."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from hidden.generator import make

from invid.diagnosis.validation import (
    PLAIN,
    VALIDATION,
    ValidationRecords,
    ValidationRequest,
    split_records,
    validation_row,
)
from invid.recording.model import Recording, Role
from invid.signals.spectra import all_spectra


@pytest.fixture(scope="module")
def recording() -> Recording:
    """One motor, several experiments of whole periods, one for validation."""
    return make(None, seed=3, motors=1, moves=False, drive="smooth", periods=3, from_rest=False)[0]


def without_validation(recording: Recording) -> Recording:
    return replace(recording, experiments=tuple(e for e in recording.experiments if e.role is Role.IDENTIFY))


def first_only(recording: Recording) -> Recording:
    return replace(recording, experiments=without_validation(recording).experiments[:1])


def in_pieces(recording: Recording) -> Recording:
    """The same cut short of two periods: no whole one is to spare."""
    cut = []
    for e in first_only(recording).experiments:
        n = int(1.4 * e.period_samples)
        cut.append(replace(e, time=e.time[:n], position=e.position[:n], torque=e.torque[:n]))
    cut = [replace(e, torque_demand=None, status=None) for e in cut]
    return replace(recording, experiments=tuple(cut))


def row(recording: Recording, asked: ValidationRequest = PLAIN) -> str:
    return validation_row(ValidationRecords(recording, all_spectra(recording), asked)).name


def test_the_first_row_that_holds_counts(recording: Recording) -> None:
    assert [r.name for r in VALIDATION] == ["role", "spare record", "last period", "fifth line"]
    assert row(recording) == "role"
    assert row(recording, ValidationRequest(split_every_record=True)) == "last period"
    several = without_validation(recording)
    more = replace(several, experiments=(*several.experiments, replace(several.experiments[0], key="900")))
    assert row(more) == "spare record"
    assert row(more, ValidationRequest(spare=False)) == "last period"
    assert row(first_only(recording)) == "last period"
    assert row(in_pieces(recording)) == "fifth line"


def test_every_row_but_the_records_own_roles_says_what_it_did(recording: Recording) -> None:
    for given, asked, said in (
        (recording, PLAIN, ""),
        (
            recording,
            ValidationRequest(split_every_record=True),
            "validation does not show what the others do: the last period",
        ),
        (first_only(recording), PLAIN, "no validation experiment (role 'validate'): the last period"),
        (in_pieces(recording), PLAIN, "every fifth line is kept out"),
    ):
        train, held, warnings = split_records(given, all_spectra(given), asked)
        assert train
        assert held
        assert len(warnings) == bool(said)
        assert said in "".join(warnings)


def test_training_and_held_out_lines_share_nothing_but_the_mean(recording: Recording) -> None:
    one = in_pieces(recording)
    (train,), (held,), _ = split_records(one, all_spectra(one))
    both = (train.weight > 0) & (held.weight > 0)
    assert not both[1:].any()
    assert ((train.weight > 0) | (held.weight > 0)).all()
