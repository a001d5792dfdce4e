"""Torque lag: the torque acts through a first-order lag of ``time_constant``.

The pure delay that comes with it is the fit's time offset; what tells a lag from a delay is that it
also weakens the torque at high frequency.
"""

from __future__ import annotations

import numpy as np

from invid.arrays import Complex128
from invid.effects.base import (
    Context,
    Effect,
    Family,
    Place,
    RecordMotion,
    Shape,
    every_axis,
    on_torque,
)


def _direct(_context: Context, record: RecordMotion, place: Place, shape: Shape) -> Complex128:
    w, tau = record.block.omega, shape[0]
    lagged = np.exp(1j * w * tau) / (1.0 + 1j * w * tau) - 1.0
    return on_torque(record, place.axis, -lagged * record.block.torque[:, place.axis])


def _grid(context: Context, _place: Place) -> list[Shape]:
    return [(f / context.top,) for f in (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)]


EFFECT = Effect(
    "torque_lag",
    Family.ACTUATOR,
    every_axis,
    lambda _c, s: {"time_constant": s[0]},
    {"time_constant": "time"},
    "Check the current controller's bandwidth and any torque filter in the drive.",
    direct=_direct,
    grid=_grid,
    unit_coefficient=True,
    words="torque that follows with a lag of {time_constant}",
)
