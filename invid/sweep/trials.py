"""Small trials before the full amplitude: are the signs right, does it move, how heavy is it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.arrays import Float64
from invid.errors import SafetyStop

EDGE_S = 0.03
"""Window on each side of an edge of torque: short against the modes of a robot, long enough for the
motor to move many encoder counts (0.5·(Δτ/m)·0.03²). Never below five cycles."""
DECISIVE = 5.0
"""Standard deviations: a wrong verdict once in three million trials."""
LAGS = (0, 1, 2, 3)
"""Cycles by which the drive may delay the torque; a later one is looked for in the measured torque."""


@dataclass(frozen=True)
class Response:
    """What a doublet of torque did to one axis."""

    inertia: float
    """Rigid inertia that would move as far, > 0 [kg·m² or kg]; rough where the axis is flexible."""
    displacement: float
    """Largest distance from the start [rad or m]."""
    mobility: float
    """Acceleration jump per torque jump, 1/m₁; negative: the signs disagree."""
    mobility_std: float
    """Its standard deviation; infinite where the edges were too short to tell."""
    torque_slope: float
    """Measured torque per demanded torque; NaN where too small to tell."""


def sign_score(found: Sequence[Response]) -> float:
    """The mobility of several trials together, in standard deviations."""
    weights = [1.0 / r.mobility_std**2 for r in found]
    total = sum(weights)
    if total == 0:
        return 0.0
    score = sum(w * r.mobility for w, r in zip(weights, found, strict=True)) / np.sqrt(total)
    return float(score)


def response(
    time: Float64, demand: Float64, torque: Float64, position: Float64, *, count: float, rated: float
) -> Response:
    """Judge a doublet by what its edges did.

    A jump of torque makes the motor's acceleration jump by Δτ/m₁ at once, whatever is behind it; springs,
    other axes and ringing from before change the acceleration only smoothly. A regression on the whole
    motion would be fooled by a resonance below the doublet's frequency.

    Parameters
    ----------
    time
        (n,) SYNC instants [s]; skipped slots may be missing.
    demand, torque, position
        (n,) demanded torque and measured torque around their values at rest, position from the start.
    count
        Position of one encoder count: the least that the path is uncertain by.
    """
    power = float(demand @ demand)
    late, follow = _lateness(demand, torque) if power > 0 else (0, float("nan"))
    amplitude = float(np.abs(demand).max(initial=0.0))
    # 0x6077 steps in thousandths and carries noise of several: below 1 % of rated the slope says nothing
    if amplitude < 0.01 * rated:
        late, follow = 0, float("nan")
    displacement = float(np.abs(position).max(initial=0.0))
    acting = time[demand != 0]
    length = float(acting[-1] - acting[0]) if acting.size > 1 else 0.0
    mobility, std = _edges(time, demand, position, count, late)
    return Response(
        inertia=amplitude * length**2 / (16 * displacement) if displacement > 0 else float("inf"),
        displacement=displacement,
        mobility=mobility,
        mobility_std=std,
        torque_slope=follow,
    )


def _lateness(demand: Float64, torque: Float64) -> tuple[int, float]:
    """Cycles by which 0x6077 follows the demand, and its slope there.

    All lags compete: the side lobes of a doublet have the other sign and half the height, so among the first
    few lags alone an answer that comes late would look like a wrong sign.
    """
    power = float(demand @ demand)
    slopes = [float(demand[: demand.size - k] @ torque[k:]) / power for k in range(max(1, demand.size // 2))]
    late = int(np.argmax(np.abs(slopes)))
    return late, slopes[late]


def _edges(time: Float64, demand: Float64, position: Float64, count: float, late: int) -> tuple[float, float]:
    """Common Δacceleration/Δtorque over all edges and its standard deviation, for the likeliest lag."""
    edges = np.flatnonzero(np.diff(demand) != 0) + 1
    step = float(np.median(np.diff(time)))
    span = max(5, round(EDGE_S / step))
    if edges.size > 1:
        span = min(span, int(np.diff(edges).min()))
    best, best_rest = (0.0, np.inf), np.inf
    for lag in (*LAGS, *(late + k for k in (-2, -1, 0, 1) if late + k > max(LAGS))):
        bends, curves = [], []
        for edge in edges:
            first, last = edge + lag - span, edge + lag + span + 1
            if first < 0 or last > position.size or span < 4:
                continue
            t = time[first:last] - time[edge + lag]
            # the torque from row ``edge`` on bends the path from there on
            bend = 0.5 * np.maximum(t, 0.0) ** 2 * (demand[edge] - demand[edge - 1])
            basis, _ = np.linalg.qr(np.vander(t / (span * step), 4))
            window = position[first:last]
            bends.append(bend - basis @ (basis.T @ bend))
            curves.append(window - basis @ (basis.T @ window))
        if not bends:
            continue
        x, y = np.concatenate(bends), np.concatenate(curves)
        power = float(x @ x)
        slope = float(x @ y) / power
        rest = y - slope * x
        squares = float(rest @ rest)
        freedom = max(1, y.size - 4 * len(bends) - 1)
        # a step of the encoder is uniform noise of a count over the root of twelve
        variance = max(squares / freedom, count**2 / 12)
        if squares < best_rest:
            best_rest, best = squares, (slope, float(np.sqrt(variance / power)))
    return best


def judge(axis: str, found: Response, score: float, *, amplitude: float, unit: str, torque_unit: str) -> None:
    """SafetyStop where a sign is wrong."""
    if found.torque_slope < -0.2:
        raise SafetyStop(
            f"axis {axis}: the measured torque (0x6077) has the opposite sign of the commanded one (0x6071) "
            f"in a trial at {amplitude:.3g} {torque_unit}; the drive's torque signs disagree: correct its "
            "configuration"
        )
    if score < 0:
        raise SafetyStop(
            f"axis {axis}: positive torque moved the encoder backwards in a trial at {amplitude:.3g} "
            f"{torque_unit} ({found.displacement:.3g} {unit}); encoder and motor disagree in sign: swap two "
            "motor phases or invert the encoder in the drive (the config's direction turns both and cannot "
            "help)"
        )
