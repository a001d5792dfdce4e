"""Small trials before the full amplitude: are the signs right, does it move, how heavy is it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from invid.arrays import Float64
from invid.errors import SafetyStop

EDGE_S = 0.02
"""Window on each side of an edge of torque: short against the modes of a robot, long enough for the
motor to move many encoder counts (0.5·(Δτ/m)·0.02²). Never below five cycles."""
DECISIVE = 5.0
"""Standard deviations: a wrong verdict once in three million trials."""
LAGS = (0, 1, 2, 3)
"""Cycles by which the drive may delay the torque."""


@dataclass(frozen=True)
class Response:
    """What a doublet of torque did to one axis."""

    inertia: float
    """Rigid inertia that would move as far, > 0 [kg·m² or kg]; rough where the axis is flexible."""
    displacement: float
    """Largest distance from the start [rad or m]."""
    sign: float
    """Acceleration jump per torque jump, in its standard deviations; negative: the signs disagree."""
    torque_slope: float
    """Measured torque per demanded torque; NaN where too small to tell."""


def response(demand: Float64, torque: Float64, position: Float64, cycle_s: float, rated: float) -> Response:
    """Judge a doublet by what its edges did.

    A jump of torque makes the motor's acceleration jump by Δτ/m₁ at once, whatever is behind it; springs,
    other axes and ringing from before change the acceleration only smoothly. A regression on the whole
    motion would be fooled by a resonance below the doublet's frequency.

    Parameters
    ----------
    demand, torque, position
        (n,) demanded torque and measured torque around their values at rest, position from the start.
    """
    power = float(demand @ demand)
    # 0x6077 lags by a cycle or two, differently for each drive: the best of the first ones
    lags = [float(demand[: demand.size - k] @ torque[k:]) / power for k in LAGS if demand.size > k + 1]
    follow = max(lags, key=abs) if power > 0 and lags else float("nan")
    amplitude = float(np.abs(demand).max(initial=0.0))
    # 0x6077 steps in thousandths and carries noise of several: below 1 % of rated the slope says nothing
    if amplitude < 0.01 * rated:
        follow = float("nan")
    displacement = float(np.abs(position).max(initial=0.0))
    length = np.count_nonzero(demand) * cycle_s
    return Response(
        inertia=amplitude * length**2 / (16 * displacement) if displacement > 0 else float("inf"),
        displacement=displacement,
        sign=_edge_score(demand, position, cycle_s),
        torque_slope=follow,
    )


def _edge_score(demand: Float64, position: Float64, cycle_s: float) -> float:
    """Common Δacceleration/Δtorque over all edges, in standard deviations, for the likeliest lag."""
    edges = np.flatnonzero(np.diff(demand) != 0) + 1
    span = max(5, round(EDGE_S / cycle_s))
    if edges.size > 1:
        span = min(span, int(np.diff(edges).min()))
    best, best_rest = 0.0, np.inf
    for lag in LAGS:
        jumps, curves = [], []
        for edge in edges:
            first, last = edge + lag - span, edge + lag + span + 1
            if first < 0 or last > position.size or span < 4:
                continue
            t = np.arange(-span, span + 1) / span
            # the torque from row ``edge`` on bends the path from there on
            bend = 0.5 * np.maximum(t, 0.0) ** 2 * (demand[edge] - demand[edge - 1])
            smooth = np.vander(t, 4)
            basis, _ = np.linalg.qr(smooth)
            window = position[first:last]
            jumps.append(bend - basis @ (basis.T @ bend))
            curves.append(window - basis @ (basis.T @ window))
        if not jumps:
            continue
        x, y = np.concatenate(jumps), np.concatenate(curves)
        slope = float(x @ y / (x @ x))
        rest = y - slope * x
        freedom = max(1, y.size - 4 * len(jumps) - 1)
        sigma = float(np.sqrt(rest @ rest / freedom / (x @ x)))
        if float(rest @ rest) < best_rest:
            best_rest, best = float(rest @ rest), slope / max(sigma, 1e-300)
    return best


def judge(axis: str, found: Response, *, amplitude: float, unit: str, torque_unit: str) -> None:
    """SafetyStop where a sign is wrong."""
    if found.torque_slope < -0.2:
        raise SafetyStop(
            f"axis {axis}: the measured torque (0x6077) has the opposite sign of the commanded one (0x6071) "
            f"in a trial at {amplitude:.3g} {torque_unit}; the drive's torque signs disagree: correct its "
            "configuration"
        )
    if found.sign < 0:
        raise SafetyStop(
            f"axis {axis}: positive torque moved the encoder backwards in a trial at {amplitude:.3g} "
            f"{torque_unit} ({found.displacement:.3g} {unit}); encoder and motor disagree in sign: swap two "
            "motor phases or invert the encoder in the drive (the config's direction turns both and cannot "
            "help)"
        )
