"""Drives whose torque acts late by more than sampling conventions explain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from invid.likelihood.unknown_forces.background import Background, bounded_fall
from invid.likelihood.unknown_forces.fitted_hypothesis import Channel, FittedHypothesis
from invid.likelihood.unknown_forces.price import price
from invid.likelihood.unknown_forces.slope import whitened_rows
from invid.likelihood.unknown_forces.timing import CONVENTION
from invid.numerics.arrays import Float64

SURELY_LATE = 5.0
"""Deviations by which a delay has to exceed conventions before a late drive is supposed."""
LAGS = tuple(0.25 * 2.0**k for k in range(9))
"""Lags that are tried [samples]."""


@dataclass(frozen=True, eq=False)
class LateDrive:
    """An axis with what its drive may do to its torque, the fit with it and the fit without it."""

    channel: Channel
    axis: int
    found: FittedHypothesis
    without: FittedHypothesis


def lag_rows(now: FittedHypothesis, axis: int, lag: float) -> list[Float64]:
    """(rows, 1) whitened rows of each stack by the logarithm of a drive's lag [samples], where delays and
    lags add up."""
    out = []
    for work in now.fit.value.work:
        acting = now.numbers.timing.acting(work.stack)
        column = np.zeros((*acting.shape, 1), dtype=complex)
        turn = 1j * work.stack.omega * now.numbers.timing.step * lag
        column[..., axis, 0] = np.log(1.0 + turn) * acting[..., axis]
        out.append(whitened_rows(work, column).reshape(-1, 1))
    return out


def late_drives(now: FittedHypothesis) -> list[LateDrive]:
    """Axes whose torque acts late by more than a sample, or where a lag may pay its price, each with a delay
    and with a lag: the delay alone of a lag of two samples is within conventions."""
    out = []
    timing, motors = now.numbers.timing, now.hypothesis.structure.motors
    background = Background.of(now)
    deviation = np.sqrt(np.diag(now.fit.covariance))[now.numbers.plant.x.size :]
    for axis in range(motors):
        if any(a == axis for _, a in now.hypothesis.channels):
            continue
        # A drive is late with command and hold alike; the hold's time alone is that of its damping too.
        weight = 1.0 / np.maximum(deviation[[axis, motors + axis]], 1e-9) ** 2
        delay = abs(float(weight @ timing.delay[:, axis])) / weight.sum()
        lags = (background.beside(lag_rows(now, axis, lag)) for lag in LAGS)
        is_late = (delay - CONVENTION) * np.sqrt(weight.sum()) > SURELY_LATE
        if not is_late and max(bounded_fall(*told, [(-np.inf, np.inf)]) for told in lags) < price():
            continue
        without = now.refit(replace(now.hypothesis, absent=now.hypothesis.absent | {(Channel.DELAY, axis)}))
        for channel in Channel:
            found = now.refit(replace(now.hypothesis, channels=now.hypothesis.channels | {(channel, axis)}))
            if channel is Channel.LAG:
                punctual = found.numbers.timing.punctual(axis)
                found = found.refit(
                    replace(found.hypothesis, absent=found.hypothesis.absent | {(Channel.DELAY, axis)}),
                    replace(found.numbers, timing=punctual),
                )
            out.append(LateDrive(channel, axis, found, without))
    return out
