"""Promises of the league of measured machines, on small records made here."""

import json
from dataclasses import replace

import numpy as np
import pytest
from large_motion import RATE, experiment, recording, simulate

from benchmarks.diagnosis import bench_league, peer_torque
from invid.cli.app import run
from invid.diagnosis.rigid import diagnose_trajectory
from invid.model.diagnosis_document import Verdict
from invid.numerics.arrays import frozen_float
from invid.recording import Role, write_recording
from invid.rigid_motion.analysis import analyse
from invid.rigid_motion.fit import fit_terms
from invid.rigid_motion.search import without_harm
from invid.rigid_motion.terms import Base

HARMONICS = [(1, 0.3), (2, 1.1), (3, 2.0), (5, 0.7)]


def arm(rng: np.random.Generator, seconds: float, weights: dict[int, float]):
    """Three joints whose torques are inertia, dry friction and weights that the later joints turn."""
    time = np.arange(0, seconds, 5 / RATE)
    q, v, a = np.zeros((3, 3, time.size))
    for i in range(3):
        for k, phase in HARMONICS:
            w, size = 2 * np.pi * k * (0.11 + 0.017 * i), rng.uniform(0.5, 1.0) / k
            q[i] += size * np.sin(w * time + phase * (i + 1))
            v[i] += size * w * np.cos(w * time + phase * (i + 1))
            a[i] -= size * w**2 * np.sin(w * time + phase * (i + 1))
    torque = 0.3 * a + 0.5 * np.sign(v)
    for i, size in weights.items():
        for j in {0, 1, 2} - {i}:
            torque[i] += size * np.sin(q[i] + 0.4) * np.cos(q[j] - 0.3 * (j + 1))
    torque += 0.02 * rng.standard_normal(torque.shape)
    return experiment(time, q.T, torque.T)


@pytest.mark.campaign
def test_weights_that_other_joints_turn_are_in_the_model_where_they_act_and_only_there():
    analysed = analyse(recording(arm(np.random.default_rng(1), 20.0, {1: 4.0, 2: 2.0})))
    carried = [t for t in analysed.final.terms if t.law is Base.CARRIED]
    assert sorted(t.axis for t in carried) == [1, 2]
    assert all(set(t.others) == {0, 1, 2} - {t.axis} for t in carried)


def test_a_cause_that_does_not_lower_what_is_missed_on_rows_kept_out_goes():
    analysed = analyse(recording(simulate(np.random.default_rng(3), dry=(0.8, 0.8), seconds=12.0)))
    rows, final = analysed.rows, analysed.final
    idle = next(t for t in analysed.candidates if t.cause == "cogging" and t.shape)
    kept = without_harm(rows, fit_terms(rows, [*final.terms, idle]))
    assert {t.cause for t in kept.terms if not t.is_base} == {"coulomb_friction"}


def test_values_that_stand_for_several_rows_are_not_explained_by_friction():
    """A torque that goes with nothing, read every third row: the motion leaps from stand to stand."""
    plain = simulate(np.random.default_rng(4), extra=lambda q, v, t: 2.0 * np.sin(2 * np.pi * 1.3 * t))
    held = np.arange(plain.samples) // 12 * 12
    stairs = replace(
        plain, position=frozen_float(plain.position[held]), torque=frozen_float(plain.torque[held])
    )
    assert diagnose_trajectory(recording(stairs)).verdict is not Verdict.EXPLAINED


@pytest.fixture(scope="module")
def record():
    whole = simulate(np.random.default_rng(5), dry=(0.8, 0.8), wet=(0.4, 0.4), seconds=12.0)
    return bench_league.kept_out(recording(whole))


def test_no_peer_of_the_league_sees_what_is_kept_out(record):
    """Another torque there changes their figures, and no prediction of theirs."""
    *fitted, held = record.experiments
    assert held.role is Role.VALIDATE
    assert held.samples == pytest.approx(sum(e.samples for e in fitted) / 3, abs=1)
    other = replace(record, experiments=(*fitted, replace(held, torque=frozen_float(-held.torque))))
    shares = peer_torque.shares(record, 20.0)
    for name, share in [(n, shares[n][0]) for n in ("rigid", "+ ripple, memory")]:
        # −τ misses |τ + τ̂|: 2 less a little where τ̂ is that of the record as it was.
        assert share < 0.3, name
        assert peer_torque.shares(other, 20.0)[name][0] > 1.5, name


def test_peers_and_product_are_judged_on_the_same_samples(record):
    held = record.experiments[-1]
    ((torque, told, step),) = bench_league.ours(record)[1][0]
    assert torque.size == told.size == held.samples
    mine = peer_torque.signals(held, 20.0)
    np.testing.assert_allclose(torque, mine.torque[:, 0], atol=1e-9)
    assert step == pytest.approx(mine.step)


def test_a_record_that_cannot_be_used_is_refused_with_a_code_and_what_was_measured(tmp_path, capsys):
    time = np.arange(2000) / 500.0
    noise = np.random.default_rng(9).standard_normal((2000, 1))
    file = tmp_path / "still.h5"
    write_recording(recording(experiment(time, np.zeros((2000, 1)), noise)), file)
    assert run(["diagnose", str(file), "--json"]) == 3
    said = json.loads(capsys.readouterr().out)
    assert said["result"] is None
    assert said["refused"]["code"] == "too_little_motion"
    assert said["refused"]["values"] == {"rows": 0, "least": 12}
    assert run(["diagnose", str(tmp_path / "none.h5"), "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["refused"]["code"] == "recording"
