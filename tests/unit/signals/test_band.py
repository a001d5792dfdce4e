"""The band of a record without a period: as far as it speaks of the machine, and not only of its motor."""

from __future__ import annotations

import numpy as np
import pytest
from hidden.aperiodic import _highest, draw

from invid.signals.band import apparent_inertia
from invid.signals.record import make_record


@pytest.mark.parametrize("seed", [330020, 330024, 330025, 330028])
def test_the_band_ends_above_the_highest_resonance_and_not_far_above(seed: int) -> None:
    recording, truth = draw(seed, seconds=10.0)
    record = make_record(recording.experiments[0], recording.encoder_resolution)
    highest = _highest(truth.masses, truth.springs) / (2 * np.pi)
    assert 1.2 * highest < record.top_hz < 6.0 * highest


@pytest.mark.parametrize("seed", [330022, 330027])
def test_above_its_resonances_a_machine_shows_its_motor(seed: int) -> None:
    recording, truth = draw(seed, seconds=10.0)
    record = make_record(recording.experiments[0], recording.encoder_resolution)
    hertz = record.wide / (2 * np.pi)
    within = hertz < record.top_hz
    seen = apparent_inertia(hertz[within], record.position[None, within], record.torque[None, within], 0)
    upper = seen.frequency > 0.7 * record.top_hz
    assert np.median(seen.inertia[upper]) == pytest.approx(truth.masses[0], rel=0.15)
