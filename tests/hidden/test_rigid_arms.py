"""Arms of rigid links in production moves are taken for rigid, whatever chains of one mass an axis fit."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from hidden.arms import _arm, draw, inverse_dynamics
from invid.cli.app import run
from invid.identification.begun import Begun
from invid.identification.machine_kind import is_of_rigid_axes, machine_kind, rigid_model
from invid.recording.hdf5 import write_recording
from invid.recording.model import Recording


def chains_of(recording: Recording, masses: int, missed: float = np.inf) -> Begun:
    """The first fit of chains as the choice of the kind sees it."""
    return cast("Begun", SimpleNamespace(sizes=(masses,) * recording.axis_count, missed=missed))


@pytest.mark.parametrize(("seed", "axes"), [(2, 5), (3, 5), (5, 4), (8, 3)])
def test_an_arm_is_rigid_where_no_elasticity_shows(seed: int, axes: int) -> None:
    recording, _ = draw(seed, axes, seconds=15.0)
    kind = machine_kind(recording, None, lambda: chains_of(recording, 1))
    assert kind.rigid
    assert kind.sentence.startswith("taken for a rigid machine: rigid axes miss")
    assert is_of_rigid_axes(rigid_model(recording, kind), recording)


@pytest.mark.panel
@pytest.mark.parametrize(("missed", "rigid"), [(2.5, True), (0.9, True), (0.01, False)])
def test_the_better_of_both_wins_and_what_the_other_misses_is_said(missed: float, rigid: bool) -> None:
    recording, _ = draw(8, 3, seconds=10.0)
    kind = machine_kind(recording, None, lambda: chains_of(recording, 2, missed))
    assert kind.rigid is rigid
    assert f"chains {missed:.1%}" in kind.sentence
    assert "rigid axes miss" in kind.sentence


def test_an_inertia_that_does_not_show_costs_trust_and_no_model() -> None:
    """The torque of one joint of a plain machine is of another kind: its inertia comes out below zero."""
    recording, _ = draw(5, 4, seconds=15.0)
    torque = recording.experiments[0].torque.copy()
    torque[:, 2] *= -1.0
    turned = replace(recording, experiments=(replace(recording.experiments[0], torque=torque),))
    kind = machine_kind(turned, None, lambda: chains_of(turned, 1))
    assert kind.rigid
    model = rigid_model(turned, kind)
    assert np.isnan(model.std.masses[2][0])
    assert model.chains.masses[2][0] > 0
    assert model.fit["trustworthy"] is False
    assert any("inertia of J3" in w for w in model.warnings)


def test_the_arms_energy_is_the_work_done_on_them() -> None:
    arm, time = _arm(np.random.default_rng(3), 4), np.linspace(0, 2, 4001)
    pace = 1 + 0.3 * np.arange(4)
    q, v = np.sin(time[:, None] * pace), pace * np.cos(time[:, None] * pace)
    a = -(pace**2) * np.sin(time[:, None] * pace)
    still = np.zeros_like(q)
    moving = inverse_dynamics(arm, q, v, a) - inverse_dynamics(arm, q, still, still)
    power = np.sum(moving * v, axis=1)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * time[1])])
    at_rest = inverse_dynamics(arm, q, still, still)
    inertia = np.stack(
        [inverse_dynamics(arm, q, still, np.tile(e, (time.size, 1))) - at_rest for e in np.eye(4)], axis=2
    )
    kinetic = 0.5 * np.einsum("ni,nij,nj->n", v, inertia, v)
    assert np.abs(work - (kinetic - kinetic[0])).max() < 1e-5 * kinetic.max()


def test_the_commands_end_with_three_where_rigid_axes_miss_half_of_the_torque(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, _ = draw(4, 3, seconds=12.0)
    experiment = recording.experiments[0]
    wander = np.cumsum(np.random.default_rng(1).standard_normal(experiment.torque.shape), axis=0)
    wander *= 2.0 * experiment.torque.std(axis=0) / wander.std(axis=0)
    foreign = replace(experiment, torque=experiment.torque + wander)
    write_recording(replace(recording, experiments=(foreign,)), tmp_path / "arm.h5")
    for command in ("identify", "diagnose"):
        status = run([command, str(tmp_path / "arm.h5"), "--masses", "1,1,1", "--json"])
        document = json.loads(capsys.readouterr().out)
        assert status == 3
        assert "misses" in document["warnings"][0]
