"""One record of the fit, and the acting torque of its torque channels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.numerics.arrays import Complex128, Float64
from invid.signals.spectral_record import SpectralLines


@dataclass(frozen=True, eq=False, kw_only=True)
class Block(SpectralLines):
    """One record on the lines that the fit of an identification uses, and which parameters it knows.

    Attributes
    ----------
    further_index
        (M,) a second delay parameter that adds to the axis' own, for the torque of a hold; −1 none.
    hold
        (F, M) hold law at work while the axis is driven, torque −hold·position acting with both
        delays while the command acts with the first alone; zero for none.
    staircase_index
        (M,) which hold-over-the-sample parameter, or −1 where it is known (``staircase``).
    staircase
        (M,) known values, used where the index is −1.
    columns
        (F, M, L) columns shared by all records (torque side, one coefficient each).
    lag_index
        (M,) which parameter among the delays is the lag of each axis' torque channel, as the square of its
        time constant [s²] (``lag_torque``); empty where no channel has one.
    stepped
        (F, M) part of the torque that is held over each sample and stands in ``torque`` as it acts.
    """

    further_index: tuple[int, ...]
    hold: Complex128
    staircase_index: tuple[int, ...]
    staircase: Float64
    columns: Complex128
    lag_index: tuple[int, ...] = ()
    stepped: Complex128 | None = None


@dataclass(frozen=True, eq=False)
class ChannelTorque:
    """The acting torque of a block and its derivatives.

    Where the hold H works beside a command, the acting torque is z₁T + (z₁ − z₂)·H·Θ: the command E = T + HΘ
    acts with z₁ (zero-order hold included), the hold's −HΘ with z₂.
    """

    factor: Complex128
    """(F, M) A."""
    hold: Complex128
    """(F, M) torque per position of a hold beside the command."""
    by_delay: Complex128
    """(F, M, delays) derivative of A."""
    hold_by_delay: Complex128
    """(F, M, delays) derivative of ``hold``, over the hold law."""
    by_zoh_share: Complex128
    """(F, M, staircase parameters) derivative of A."""
    folded: Complex128
    """(F, M) mass times displacement that the images of held torque alias onto the lines (``folding``)."""


def channel_torque(block: Block, delays: Float64, stairs: Float64) -> ChannelTorque:
    """The acting torque of ``block`` for ``delays`` [s] and held shares ``stairs``.

    The axes' own delays come first; squares of lags [s²] are among the others.
    """
    motors, lines = block.position.shape[1], block.omega.size
    jw = 1j * block.omega
    loss = block.folding.zoh_loss
    factor = np.ones((lines, motors), dtype=complex)
    hold_part = np.zeros((lines, motors), dtype=complex)
    by_delay = np.zeros((lines, motors, delays.size), dtype=complex)
    by_hold = np.zeros((lines, motors, delays.size), dtype=complex)
    by_stair = np.zeros((lines, motors, stairs.size), dtype=complex)
    stepped = np.zeros((lines, motors), dtype=complex)
    steps_at = np.zeros(motors)
    for i in range(motors):
        further = block.further_index[i]
        own = delays[i]
        has_hold = block.hold[:, i].any()
        late = own + (delays[further] if further >= 0 else 0.0)
        z = np.exp(-jw * (own if has_hold else late))
        stair = block.staircase_index[i]
        share = stairs[stair] if stair >= 0 else block.staircase[i]
        factor[:, i] = z * (1.0 - share * loss)
        steps_at[i] = own if has_hold else late
        if block.stepped is not None and block.stepped[:, i].any():
            stepped[:, i] = block.stepped[:, i]
        else:
            stepped[:, i] = share * block.torque[:, i]
            steps_at[i] -= block.step / 2  # the delay contains the half sample of holding
        if stair >= 0:
            by_stair[:, i, stair] = -z * loss
        by_delay[:, i, i] = -jw * factor[:, i]
        if has_hold:
            z2 = np.exp(-jw * late)
            z1 = factor[:, i].copy()
            hold_part[:, i] = (z1 - z2) * block.hold[:, i]
            by_hold[:, i, i] = -jw * (z1 - z2)
            if further >= 0:
                by_hold[:, i, further] = jw * z2
        elif further >= 0:
            by_delay[:, i, further] = -jw * factor[:, i]
        if block.lag_index:
            lag = block.lag_index[i]
            lag_gain, slope = lag_torque(block.omega, float(delays[lag]))
            for values in (factor, hold_part, by_delay, by_hold, by_stair):
                values[:, i] *= lag_gain if values.ndim == 2 else lag_gain[:, None]
            by_delay[:, i, lag] = slope * factor[:, i]
            if has_hold:
                by_hold[:, i, lag] = slope * lag_gain * (z1 - z2)
    images = block.folding.at(steps_at) * stepped
    return ChannelTorque(factor, hold_part, by_delay, by_hold, by_stair, images)


def lag_torque(omega: Float64, square: float) -> tuple[Complex128, Complex128]:
    """(F,) acting torque over one recorded through a first-order lag, and (F,) derivative of its logarithm.

    By τ² = ``square``. The delay of the lag is in the time offset already; without it the factor is (1 +
    jωτ)e^{−jωτ}, smooth in τ² through zero. Negative: the inverse, the position channel lags.
    """
    tau = np.sqrt(abs(square))
    lag = 1.0 + 1j * omega * tau
    factor = lag * np.exp(-1j * omega * tau)
    slope: Complex128 = omega**2 / (2.0 * lag)
    gain: Complex128 = factor if square >= 0 else 1.0 / factor
    return gain, slope


__all__ = ["Block", "ChannelTorque", "channel_torque", "lag_torque"]
