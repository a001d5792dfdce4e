"""Coulomb friction at the motors as a column of the fit: the spectrum of the velocity's sign."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Bool, Complex128, Float64
from invid.signals.spectra import LineSpectra


def motor_velocity(s: LineSpectra) -> tuple[Float64, Float64]:
    """(n, M) velocity of the averaged wave and (M,) its noise, both after a Wiener filter.

    Differentiation is spectral; each line is scaled by the share of its power that is signal, so
    quantisation does not become velocity.
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
    velocity = np.fft.irfft(speed, count, axis=0) + ramp
    left = (omega[:, None] ** 2 * noise * (keep > 0)).sum(axis=0) * 2 / count**2
    return velocity, np.sqrt(left)


def coulomb_columns(s: LineSpectra) -> tuple[Complex128, Bool]:
    """(F, M) spectrum of the sign of each motor's velocity, and (M,) whether it moves significantly.

    From the position alone; ``nuisance.reversals`` finds the reversals better once there is a model.
    """
    sign, moves = velocity_signs(s)
    return sign_spectrum(s, sign), moves


def velocity_signs(s: LineSpectra) -> tuple[Float64, Bool]:
    """(n, M) mean sign of each motor's velocity over each sample, and (M,) whether it moves significantly."""
    velocity, noise = motor_velocity(s)
    rms = np.sqrt(np.mean(velocity**2, axis=0))
    smooth = np.maximum(2.0 * noise, 1e-3 * np.maximum(rms, 1e-300))
    moves: Bool = rms > 10.0 * noise
    return mean_sign(velocity, smooth, periodic=not s.transient or s.periods > 1), moves


def sign_spectrum(s: LineSpectra, sign: Float64) -> Complex128:
    """(F, M) amplitudes of (n, M) signs on the lines of the spectra."""
    count = sign.shape[0]
    lines = np.round(s.frequency_hz * count / s.sample_rate_hz).astype(int)
    spectrum: Complex128 = np.fft.rfft(sign, axis=0)[lines] * (2.0 / count)
    return spectrum


def mean_sign(velocity: Float64, smooth: Float64, *, periodic: bool) -> Float64:
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
