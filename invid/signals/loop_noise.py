"""Torque that a loop makes of its encoder's own noise: it acts, and is no noise of the torque's sensor."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Complex128, Float64
from invid.numerics.linear_algebra import least_squares, real_rows

TAPS = 6
"""Samples of the reading that a command may follow: a position and a speed, up to four cycles late."""
ENOUGH = 20_000
"""Lines that are looked at, of long records evenly among all: they tell the share to one per cent."""
LOUD = 10.0
"""Power over that of the quiet lines beyond which one carries a signal: 1 in 20 000 of pure noise does."""


def sensor_noise_share(spectra: Complex128, hz: Float64, step: float) -> Float64:
    """(2M,) share of each channel on the quiet lines that is its sensor's noise: all of a reading, and of a
    torque what does not follow from the axis' own reading.

    ``spectra`` (P, F, 2M) [rad or m, N·m or N] of the quiet lines alone, ``hz`` (F,), ``step`` [s]. What a
    hold or a position loop commands of the noise on its reading is logged as it acts. The missing torque
    r = Z(Θ + n) − T then holds Z n and nothing of T; taken for a sensor's noise it put the floor of empty
    records two to five times too high. One where too few lines are left to tell.
    """
    every = max(spectra.shape[0] * spectra.shape[1] // ENOUGH, 1)
    spectra, hz = spectra[:, ::every], hz[::every]
    motors = spectra.shape[2] // 2
    out = np.ones(2 * motors)
    turn = np.exp(-2j * np.pi * hz * step)[:, None] ** np.arange(TAPS)
    for i in range(motors):
        reading, torque = spectra[:, :, i], spectra[:, :, motors + i]
        quiet = _quiet(reading) & _quiet(torque)
        level = float(np.median(np.abs(torque) ** 2)) if torque.size else 0.0
        if quiet.sum() < 10 * TAPS or level <= 0.0:
            continue
        taps = reading[..., None] * turn
        rows, target = taps[quiet], torque[quiet]
        if not np.any(rows, axis=0).all():
            continue
        rest = torque - taps @ least_squares(real_rows(rows), real_rows(target), rcond=1e-10)
        freedom = 1.0 - TAPS / (2.0 * quiet.sum())
        out[motors + i] = min(float(np.median(np.abs(rest[quiet]) ** 2)) / freedom / level, 1.0)
    return out


def _quiet(lines: Complex128) -> np.ndarray:
    power = np.abs(lines) ** 2
    quiet: np.ndarray = power <= LOUD * np.median(power) / np.log(2.0)
    return quiet
