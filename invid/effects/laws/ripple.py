"""A sinusoid of position as the two coefficients that a fit moves."""

from __future__ import annotations

import numpy as np


def rotate_phase(amplitude: float, phase: float) -> tuple[float, float]:
    """a·sin(x + φ) as (a·cos φ)·sin x + (a·sin φ)·cos x."""
    return float(amplitude * np.cos(phase)), float(amplitude * np.sin(phase))
