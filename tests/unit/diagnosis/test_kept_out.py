"""What is kept out of every fit: the first row of the table that holds."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))
from hidden.generator import make

from invid.diagnosis.unknown_forces.kept_out import VALIDATION, records_of
from invid.errors import InputError
from invid.recording.model import Recording, Role


@pytest.fixture(scope="module")
def recording() -> Recording:
    """One motor, several experiments of whole periods, one for validation."""
    return make(None, seed=3, motors=1, moves=False, drive="smooth", periods=3, from_rest=False)[0]


def of_role(recording: Recording, role: Role, count: int | None = None) -> Recording:
    return replace(recording, experiments=recording.with_role(role)[:count])


def in_pieces(recording: Recording) -> Recording:
    """One experiment cut short of two periods: no whole one is to spare."""
    (e,) = of_role(recording, Role.IDENTIFY, 1).experiments
    n = int(1.4 * e.period_samples)
    cut = replace(e, time=e.time[:n], position=e.position[:n], torque=e.torque[:n])
    return replace(recording, experiments=(replace(cut, torque_demand=None, status=None),))


def test_the_first_row_that_holds_counts_and_says_what_it_did(recording: Recording) -> None:
    assert [r.name for r in VALIDATION] == ["role", "spare record", "last period", "fifth line"]
    alone = of_role(recording, Role.IDENTIFY)
    for given, said in (
        (recording, ""),
        (alone, "is kept out of every fit instead; record one with another realisation and amplitude"),
        (of_role(recording, Role.IDENTIFY, 1), "(role 'validate'): the last period of each experiment"),
        (in_pieces(recording), "every fifth line is kept out"),
    ):
        split = records_of(given)
        assert split.fitted
        assert split.kept
        assert bool(split.warnings) == bool(said)
        assert said in "".join(split.warnings)


def test_lines_fitted_and_kept_out_share_nothing_but_the_mean(recording: Recording) -> None:
    split = records_of(in_pieces(recording))
    (fitted,), (kept,) = split.fitted, split.kept
    assert np.intersect1d(fitted.used, kept.used).tolist() == [0]


def test_without_anything_to_fit_the_role_is_named(recording: Recording) -> None:
    with pytest.raises(InputError, match="no experiment with role 'identify'"):
        records_of(of_role(recording, Role.VALIDATE))
