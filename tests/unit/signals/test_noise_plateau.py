"""The noise nearest above the band of the motion: white, of an encoder's lines, behind a tail of motion."""

from __future__ import annotations

import numpy as np
import pytest

from invid.signals.noise import noise_plateau

HZ = np.arange(1, 8001) / 16.0
"""Lines of 16 s sampled at 1 kHz."""


def _power(level: np.ndarray, seed: int) -> np.ndarray:
    """Power of complex noise of the mean ``level`` (F,)."""
    return level * np.random.default_rng(seed).exponential(size=level.size)


@pytest.mark.parametrize("seed", range(5))
def test_an_encoders_error_counts_as_far_as_its_lines_pass(seed) -> None:
    quiet = HZ > 15.0
    level = np.where(HZ < 110.0, 70.0, 1.0)
    found = noise_plateau(_power(level, seed)[quiet], HZ[quiet])
    assert found.level == pytest.approx(70.0, rel=0.15)
    assert 90.0 < found.high < 140.0
    assert np.median(_power(level, seed)[quiet]) / np.log(2.0) < 3.0  # what a median of all lines says
