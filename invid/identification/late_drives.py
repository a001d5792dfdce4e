"""Drives whose torque acts late by more than sampling conventions explain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from invid.likelihood.unknown_forces.supposition import Channel, Supposed
from invid.likelihood.unknown_forces.timing import CONVENTION

SURELY_LATE = 5.0
"""Deviations by which a delay has to exceed conventions before a late drive is supposed."""


@dataclass(frozen=True, eq=False)
class LateDrive:
    """An axis with what its drive may do to its torque, the fit with it and the fit without it."""

    channel: Channel
    axis: int
    found: Supposed
    without: Supposed


def late_drives(now: Supposed) -> list[LateDrive]:
    """Axes whose torque acts late by more than a sample, each with a delay and with a lag."""
    out = []
    timing, motors = now.numbers.timing, now.hypothesis.structure.motors
    deviation = np.sqrt(np.diag(now.fit.covariance))[now.numbers.plant.x.size :]
    for axis in range(motors):
        if any(a == axis for _, a in now.hypothesis.channels):
            continue
        # A drive is late with command and hold alike; the hold's time alone is that of its damping too.
        weight = 1.0 / np.maximum(deviation[[axis, motors + axis]], 1e-9) ** 2
        delay = abs(float(weight @ timing.delay[:, axis])) / weight.sum()
        if (delay - CONVENTION) * np.sqrt(weight.sum()) < SURELY_LATE:
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
