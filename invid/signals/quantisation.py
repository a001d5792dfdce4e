"""What a coarse encoder adds to the lines: rounding of a slow motion is no white noise.

Rounding of a motion of many counts a sample is white: q²/12 over all frequencies. An axis that is held
moves a few counts in many samples; the same q²/12 then lies mostly within the band of the motion, ten
and more times the white density, repeats with the motion, and the quiet lines above do not show it.
"""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Float64


def rounding_power(single: Float64, mean: Float64, step: Float64, top: int) -> Float64:
    """Power of the rounding error on the lines within the band of the motion.

    A motion without content above ``top`` leaves there nothing but its rounding (and noise). What of the
    whole q²/12 is not seen there lies below, where it cannot be told from motion; it is spread evenly, and
    over odd and even lines as it is above (a half-wave symmetric motion has its rounding on odd lines).

    Parameters
    ----------
    single
        (L, C) mean square amplitude of lines 1…L (to the Nyquist frequency) of one period [unit²].
    mean
        (L, C) square amplitude of the average over the periods: what does not repeat is less there.
    step
        (C,) lattice q of each channel, 0 for none [unit].
    top
        Lines 1…top are the band of the motion.

    Returns
    -------
    (top, C) mean square amplitude of the averaged lines [unit²]; zero for channels without lattice, and for
    those with so much noise above the band that it hides q²/12: their quiet lines tell all.
    """
    # Σ|X_k|²/2 over all lines is the variance.
    above = single[top:].sum(axis=0)
    within = np.maximum(2.0 * step**2 / 12.0 - above, 0.0)
    averaged = mean[top:].sum(axis=0)
    kept = np.where(above > 0, averaged / np.maximum(above, 1e-300), 1.0)
    power = np.zeros((top, single.shape[1]))
    # Line k has index k − 1.
    for parity in (0, 1):
        outside = mean[top + (parity - top) % 2 :: 2].sum(axis=0)
        share = np.where(averaged > 0, outside / np.maximum(averaged, 1e-300), 0.5)
        lines = power[parity::2].shape[0]
        if lines:
            power[parity::2] = kept * share * within / lines
    return power
