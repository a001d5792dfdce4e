"""Gaps in the time stamps: what is put where samples never came."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from invid.recording.model import Experiment, Kind, Role
from invid.signals.timebase import resample_uniformly

RATE, PERIOD = 1000.0, 500


def _record(rng: np.random.Generator) -> Experiment:
    """Four periods of odd lines up to 150 Hz, coasting slowly."""
    t = np.arange(4 * PERIOD) / RATE
    lines = np.arange(1, 76, 2) * 2.0
    phase = rng.uniform(0, 2 * np.pi, lines.size)
    torque = np.cos(2 * np.pi * lines[:, None] * t + phase[:, None]).sum(axis=0)
    return Experiment(
        key="000",
        role=Role.IDENTIFY,
        kind=Kind.MULTISINE,
        time=t,
        position=(1e-3 * torque + 0.02 * t)[:, None],
        torque=torque[:, None],
        sample_rate_hz=RATE,
        excited_axis=0,
        frequencies_hz=lines,
        period_samples=PERIOD,
        hold_gain=np.zeros(1),
    )


def _without(e: Experiment, first: int, last: int) -> Experiment:
    kept = np.r_[0:first, last : e.time.size]
    return replace(e, time=e.time[kept], position=e.position[kept], torque=e.torque[kept])


def test_a_long_gap_in_a_record_that_repeats_is_filled_from_its_other_periods() -> None:
    whole = _record(np.random.default_rng(4))
    found = resample_uniformly(_without(whole, 700, 760))
    assert found.lost == 60
    assert np.abs(found.torque - whole.torque).max() < 1e-6
    assert np.abs(found.position - whole.position).max() < 1e-9
