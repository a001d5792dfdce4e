"""Diagnosis of recordings with hidden effects, made by the plants of ``tests/hidden``."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from hidden.generator import make

from invid.cli.app import run
from invid.diagnosis.diagnose import diagnose
from invid.diagnosis.rules.dropped_rows import find_dropped_rows
from invid.errors import InputError
from invid.model.diagnosis_document import Verdict
from invid.recording import Role, write_recording

QUICK = {"seed": 11, "motors": 1}


def test_a_plant_without_effect_is_consistent_and_nothing_is_named() -> None:
    recording, _ = make(None, **QUICK)
    d = diagnose(recording)
    assert d.verdict is Verdict.CONSISTENT
    assert d.findings == ()
    for r in d.residual:
        assert r.after == pytest.approx(r.noise_floor, rel=0.25)


def test_without_validation_experiments_something_is_kept_out_and_a_warning_says_so() -> None:
    recording, _ = make("coulomb_friction", target_db=20, **QUICK)
    alone = replace(recording, experiments=tuple(e for e in recording.experiments if e.role is Role.IDENTIFY))
    d = diagnose(alone)
    assert any("no validation experiment" in w for w in d.warnings)
    assert [f.effect.cause for f in d.findings] == ["coulomb_friction"]


def test_dropped_samples_are_found_with_their_share_and_sound_ones_are_not() -> None:
    recording, truth = make("dropped_samples", **QUICK)
    found = find_dropped_rows(recording)
    assert [recording.axes[f.axis] for f in found] == [truth.effects[0].axis]
    assert found[0].fraction == pytest.approx(truth.effects[0].parameters["fraction"], rel=0.3)
    assert find_dropped_rows(make(None, **QUICK)[0]) == []


def test_a_held_axis_whose_torque_follows_from_its_coarse_position_has_lost_no_rows() -> None:
    """Position and torque repeat together there, at every sample in which it moves less than a count."""
    recording, _ = make(None, seed=5, motors=2, drive="sampled", moves=False, noise=2e-3)
    first, *others = (e for e in recording.experiments if e.role is Role.IDENTIFY)
    count = 2 * np.pi / 2.0**12
    position, torque = first.position.copy(), first.torque.copy()
    position[:, 1] = count * np.round(3.0 * np.sin(0.2 * np.arange(position.shape[0])))
    torque[:, 1] = -50.0 * position[:, 1]
    held = replace(first, excited_axis=0, position=position, torque=torque)
    assert find_dropped_rows(replace(recording, experiments=(held, *others))) == []


def test_a_model_of_another_robot_is_refused_with_both_lists_of_axes() -> None:
    recording, _ = make(None, **QUICK)
    d = diagnose(recording)
    other = replace(recording, axes=("other",))
    with pytest.raises(InputError, match="other"):
        diagnose(other, model=d.model)


@pytest.mark.campaign
def test_the_command_writes_the_contract_s_document_and_prints_it_alone(tmp_path, capsys) -> None:
    recording, _ = make("coulomb_friction", target_db=20, **QUICK)
    path, out = tmp_path / "r.h5", tmp_path / "d.json"
    write_recording(recording, path)
    assert run(["diagnose", str(path), "-o", str(out), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown == json.loads(out.read_text(encoding="utf-8"))
    assert shown["format"] == "invid-diagnosis"
    assert shown["findings"][0]["cause"] == "coulomb_friction"
    assert set(shown["findings"][0]["gain"]["held_out"]) == {"before", "after"}
    assert shown["model"]["effects"][0]["cause"] == "coulomb_friction"
    assert np.isfinite(shown["explained_fraction"])


def test_a_file_that_is_not_there_is_bad_input(tmp_path) -> None:
    assert run(["diagnose", str(tmp_path / "no.h5")]) == 2
