"""Motion of motors beyond the band, completed by their own equation, against what was simulated."""

from __future__ import annotations

import numpy as np
import pytest

import hidden.cells as cells
from invid.diagnosis.diagnose import diagnose
from invid.diagnosis.rules import whole_search


@pytest.mark.parametrize("seed", [410300, 410303, 410306])
def test_the_speed_at_reversals_is_nearer_the_truth_than_the_encoder_shows(seed, monkeypatch) -> None:
    simulated, seen = [], []
    simulate, complete = cells._simulated, whole_search.complete_motion
    monkeypatch.setattr(
        cells,
        "_simulated",
        lambda plant, *rest: simulated.append((plant, simulate(plant, *rest))) or simulated[-1][1],
    )
    recording, _ = cells.draw(seed, faults=())

    def spied(records, fitted):
        out = complete(records, fitted)
        seen.append((records, out))
        return out

    monkeypatch.setattr(whole_search, "complete_motion", spied)
    diagnose(recording)
    plant, run = simulated[-2]  # the last but one is the record that identifies
    errors = []
    for coarse in (pair[0] for pair in seen[-2]):
        record = coarse if coarse.fine is None else coarse.fine
        samples = record.torque_wave.shape[0]
        speed = run[4][:, plant.motors[0]]
        speed = speed[: speed.size // samples * samples].reshape(-1, samples).mean(axis=0)  # of its periods
        at = np.arange(speed.size) * record.step
        own = np.interp(at, np.arange(record.samples) * record.wave_step, record.motor_velocity[:, 0])
        slow = np.abs(speed) < 0.1 * speed.std()
        slow[: speed.size // 20] = slow[-speed.size // 20 :] = False
        errors.append(float(np.std((own - speed)[slow])))
    measured, completed = errors
    assert completed < 0.75 * measured
