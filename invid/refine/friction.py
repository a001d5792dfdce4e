"""Coulomb friction at the motors as a column of the fit: the spectrum of the sign of the velocity."""

from __future__ import annotations

import numpy as np

from invid.arrays import Bool, Complex128, Float64
from invid.spectra import LineSpectra

SHARPENED = 4
"""Rounds in which kinks and reversals are found from each other (empirical: the shift halves in each)."""


def motor_velocity(s: LineSpectra, beyond: Complex128 | None = None) -> tuple[Float64, Float64]:
    """(n, M) velocity of the averaged wave and (M,) its noise, both after a Wiener filter.

    Differentiation is spectral; each line is scaled by the share of its power that is signal, so
    quantisation does not become velocity. ``beyond`` (n/2 + 1, M) is the spectrum of the velocity as it is
    expected, which fills what the filter takes away.
    """
    wave = np.asarray(s.position_wave)
    count, motors = wave.shape
    step = 1.0 / s.sample_rate_hz
    ramp = np.zeros(motors)
    if s.transient and s.periods == 1:
        # A record that does not close is differentiated without the line between its ends.
        ramp = (wave[-1] - wave[0]) / ((count - 1) * step)
        wave = wave - np.arange(count)[:, None] * step * ramp
    spectrum = np.fft.rfft(wave - wave.mean(axis=0), axis=0)
    omega = 2 * np.pi * np.fft.rfftfreq(count, step)
    noise = s.floor[:motors] * (count / 2.0) ** 2
    power = np.abs(spectrum) ** 2
    # Lines within four times the noise power are taken for noise (1 line in 50 of pure noise passes).
    keep = np.where(power > 4.0 * noise, 1.0 - noise / np.maximum(power, 1e-300), 0.0)
    speed = 1j * omega[:, None] * spectrum * keep
    if beyond is not None:
        speed = speed + (1.0 - keep) * beyond
    velocity = np.fft.irfft(speed, count, axis=0) + ramp
    left = (omega[:, None] ** 2 * noise * (keep > 0)).sum(axis=0) * 2 / count**2
    return velocity, np.sqrt(left)


def coulomb_columns(s: LineSpectra, slowed: Float64 | None = None) -> tuple[Complex128, Bool]:
    """(F, M) spectrum of sign(velocity) of each motor on all lines, and (M,) whether it moves clearly.

    ``slowed`` (M,) is friction over motor inertia. Where friction turns round the velocity has a kink, whose
    high frequencies drown in the noise; without them the velocity crosses zero too early, by a millisecond
    where a motor reverses slowly, always to the same side. There the motor is inertia alone: the friction
    found says how the velocity goes on beyond the noise.
    """
    velocity, noise = motor_velocity(s)
    count = velocity.shape[0]
    rms = np.sqrt(np.mean(velocity**2, axis=0))
    smooth = np.maximum(2.0 * noise, 1e-3 * np.maximum(rms, 1e-300))
    periodic = not s.transient or s.periods > 1
    sign = _mean_sign(velocity, smooth, periodic=periodic)
    omega = 2 * np.pi * np.fft.rfftfreq(count, 1.0 / s.sample_rate_hz)
    ratio = np.zeros(rms.size) if slowed is None else slowed
    for _ in range(SHARPENED if np.any(ratio) else 0):
        beyond = np.zeros((omega.size, velocity.shape[1]), dtype=complex)
        beyond[1:] = -np.fft.rfft(sign, axis=0)[1:] * ratio / (1j * omega[1:, None])
        velocity, _ = motor_velocity(s, beyond)
        sign = _mean_sign(velocity, smooth, periodic=periodic)
    lines = np.round(s.frequency_hz * count / s.sample_rate_hz).astype(int)
    spectrum: Complex128 = np.fft.rfft(sign, axis=0)[lines] * (2.0 / count)
    moves: Bool = rms > 10.0 * noise
    return spectrum, moves


def _mean_sign(velocity: Float64, smooth: Float64, *, periodic: bool) -> Float64:
    """(n, M) tanh(v/smooth) averaged over each sample's interval, v a straight line between half samples.

    The sign at the sampling instants alone puts every reversal on the grid: jitter of a sample, twice
    the friction high, which aliases into the band as noise.
    """
    count = velocity.shape[0]
    after = np.roll(velocity, -1, axis=0) if periodic else np.concatenate((velocity[1:], velocity[-1:]))
    middle = 0.5 * (velocity + after)
    before = np.roll(middle, 1, axis=0) if periodic else np.concatenate((velocity[:1], middle[: count - 1]))
    mean: Float64 = 0.5 * (
        _segment(before / smooth, velocity / smooth) + _segment(velocity / smooth, middle / smooth)
    )
    return mean


def _segment(a: Float64, b: Float64) -> Float64:
    """Mean of tanh over a straight line from a to b: the change of log cosh over b − a."""
    change = b - a
    flat = np.abs(change) < 1e-6
    value: Float64 = np.where(
        flat, np.tanh(0.5 * (a + b)), (_log_cosh(b) - _log_cosh(a)) / np.where(flat, 1.0, change)
    )
    return value


def _log_cosh(x: Float64) -> Float64:
    size = np.abs(x)
    value: Float64 = size + np.log1p(np.exp(-2.0 * size)) - np.log(2.0)
    return value
