"""What a slow move beside the excitation tells of gravity and a constant torque."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from hidden.generator import make

from invid.diagnosis.diagnose import diagnose
from invid.diagnosis.slow_move import find_slow_moves
from invid.recording.model import Experiment, Kind, Recording, Role


def test_gravity_on_a_small_motion_is_told_from_a_constant_torque_by_a_slow_move() -> None:
    recording, truth = make("gravity", seed=500022, target_db=8.0, masses=(2,), moves=True, periods=2)
    (finding,) = diagnose(recording).findings
    true = truth.effects[0].parameters["torque"]
    assert finding.effect.cause == "gravity"
    assert abs(finding.effect.parameters["torque"].value - true) < 0.1 * true


def test_acceleration_and_torque_of_a_move_are_means_over_the_same_stretches() -> None:
    step = 0.004
    time = np.arange(3000) * step
    # 2 kg·m² turned by 0.3 sin(1.7 t) rad and shaken at 9 Hz beside it: torque is inertia times acceleration.
    slow, fast = 1.7, 2 * np.pi * 9.0
    position = 0.3 * np.sin(slow * time) + 1e-3 * np.cos(fast * time)
    torque = -2.0 * (0.3 * slow**2 * np.sin(slow * time) + 1e-3 * fast**2 * np.cos(fast * time))
    one = Experiment(
        key="000",
        kind=Kind.CONSTANT_VELOCITY,
        role=Role.IDENTIFY,
        excited_axis=-1,
        hold_gain=np.full(1, np.nan),
        period_samples=0,
        frequencies_hz=np.zeros(0),
        sample_rate_hz=1 / step,
        time=time,
        position=position[:, None],
        torque=torque[:, None],
    )
    recording = Recording(
        robot="r", axes=("A",), position_unit="rad", torque_unit="N·m", created="", experiments=(one,)
    )
    (move,) = find_slow_moves(recording)
    assert move.torque.shape[0] >= 20
    assert np.abs(move.torque - 2.0 * move.acceleration).max() < 0.01 * np.abs(move.torque).max()
    short = replace(one, time=time[:20], position=one.position[:20], torque=one.torque[:20])
    assert find_slow_moves(replace(recording, experiments=(short,))) == ()
