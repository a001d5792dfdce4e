"""Small trials before the full amplitude: are the signs right, does it move, how heavy is it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.arrays import Float64
from invid.errors import SafetyStop


@dataclass(frozen=True)
class Response:
    """What a doublet of torque did to one axis."""

    inertia: float
    """Rigid inertia that explains the displacement [kg·m² or kg]."""
    displacement: float
    """Largest distance from the start [rad or m]."""
    torque_slope: float
    """Measured torque per demanded torque; NaN where too small to tell."""


def response(demand: Float64, torque: Float64, position: Float64, cycle_s: float, rated: float) -> Response:
    """Regress the motion on the double integral of the demanded torque.

    Parameters
    ----------
    demand, torque, position
        (n,) demanded torque and measured torque around their values at rest, position from the start.
    """
    # semi-implicit sums: the torque of a row acts until the next row
    velocity = np.cumsum(demand) * cycle_s
    path = np.concatenate(([0.0], np.cumsum(velocity)[:-1])) * cycle_s
    path = path - path[0]
    # The slope of the position on its double integral, a constant velocity (creeping, sagging) aside.
    design = np.column_stack([path, np.arange(path.size) * cycle_s])
    slope = float(np.linalg.lstsq(design, position, rcond=None)[0][0])
    power = float(demand @ demand)
    follow = float(demand @ torque / power) if power > 0 else float("nan")
    # 0x6077 steps in thousandths: below two of them the slope says nothing
    if float(np.abs(demand).max(initial=0.0)) < 0.004 * rated:
        follow = float("nan")
    return Response(
        inertia=1.0 / slope if slope != 0 else float("inf"),
        displacement=float(np.abs(position).max(initial=0.0)),
        torque_slope=follow,
    )


def judge(axis: str, found: Response, *, amplitude: float, unit: str, torque_unit: str) -> None:
    """SafetyStop where a sign is wrong."""
    if found.torque_slope < -0.2:
        raise SafetyStop(
            f"axis {axis}: the measured torque (0x6077) has the opposite sign of the commanded one "
            "(0x6071) in a "
            f"trial at {amplitude:.3g} {torque_unit}; the drive's torque signs disagree: correct its "
            "configuration"
        )
    if found.inertia < 0:
        raise SafetyStop(
            f"axis {axis}: positive torque moved the encoder backwards in a trial at {amplitude:.3g} "
            f"{torque_unit} "
            f"({found.displacement:.3g} {unit}); encoder and motor disagree in sign: swap two motor "
            "phases or "
            "invert the encoder in the drive (the config's direction turns both and cannot help)"
        )
