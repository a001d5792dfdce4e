"""Diagnosis of recordings with hidden effects, made by the plants of ``tests/hidden``."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hidden.generator import make

from invid.cli.app import run
from invid.diagnosis.diagnose import diagnose
from invid.identification.identify import identify
from invid.model.diagnosis_document import Verdict
from invid.recording import Experiment, Recording, Role, write_recording
from invid.signals.dropped_rows import find_dropped_rows

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


def held(recording: Recording, rows: int) -> Recording:
    """The recording as a logger writes that is ``rows`` times as fast as the values it is given."""

    def logged(e: Experiment) -> Experiment:
        rate = rows * e.sample_rate_hz
        columns = {n: np.repeat(v, rows, axis=0) for n, v in e.datasets().items() if n != "time"}
        time = e.time[0] + np.arange(rows * e.samples) / rate
        return replace(e, time=time, sample_rate_hz=rate, period_samples=rows * e.period_samples, **columns)

    return replace(recording, experiments=tuple(map(logged, recording.experiments)))


def test_a_sound_machine_whose_rows_are_held_has_dropped_none() -> None:
    """Identification and diagnosis see one row of each value, and the same machine."""
    recording, truth = make(None, **QUICK)
    logged = held(recording, 5)
    d, model = diagnose(logged), identify(logged)
    assert d.verdict is Verdict.CONSISTENT
    assert any("one row of each is used" in w for w in d.warnings)
    for found in (d.model.chains, model.chains):
        for value, true in zip(found.masses[0], truth.chains.masses[0], strict=True):
            assert value == pytest.approx(true, rel=0.01)


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
