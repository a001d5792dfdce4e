"""Judge small trials before the full amplitude: are the signs right, does it move, how heavy is it?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from invid.errors import SafetyStop
from invid.numerics.arrays import Bool, Float64
from invid.wording.sentence import sentence

EDGE_S = 0.03
"""Window on each side of an edge of torque: short against the modes of a robot, long enough for the
motor to move many encoder counts (0.5·(Δτ/m)·0.03²). Never below five cycles."""
DECISIVE = 5.0
"""Standard deviations: a wrong verdict once in three million trials."""
LAGS = (0, 1, 2, 3)
"""Cycles by which the drive may delay the torque; a later one is looked for in the measured torque."""
OPPOSITE = -0.2
"""Measured torque per demanded torque below which the two have opposite signs. A drive that obeys shows 1,
one with a wrong sign -1, one that shows nothing 0; the noise of 0x6077 (0.5 % of rated on 20 samples at 1 %
of rated) is 0.1. A wrong sign must show twice."""
SETTLED_ROWS, SCALE = 16, 0.25
"""Samples of a step of torque in which it settles, and how far what is shown may be from what is asked there:
plates and currents of a motor's rated point differ by a tenth, torque and current of a saturated one by a
fifth; a wrong unit or rated value is further off (empirical)."""
SIDE_ROWS = 4
"""Samples that an edge needs on each side: a cubic and a bend have five coefficients."""
PAUSE = 1.5
"""A step of time above one and a half cycles is a skipped slot."""
LEAST_EDGES = 2
"""A doublet has four edges; with punctual samples around fewer than two, it says nothing of the sign."""


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
    stood: bool = False
    """Whether the encoder showed one value all through the last quarter of the doublet, where any axis that
    the torque can move is slowed down, stopped or moved back."""
    edges: int = 0
    """Edges of torque that were judged: enough samples came around them, and no slot was skipped there."""
    late_edges: int = 0
    """Edges that were not, because the computer or an answer was late."""
    settled_slope: float = float("nan")
    """Measured torque per demanded torque where the demand has stood for a while; NaN where it never did."""
    settled_std: float = float("inf")
    """Its standard deviation."""

    @property
    def opposed(self) -> bool:
        """Return whether the measured torque has the opposite sign of the commanded one."""
        return self.torque_slope < OPPOSITE

    @property
    def first_mass(self) -> float:
        """Return the lightest first mass that the jumps of acceleration allow; 0: they tell nothing."""
        jump = self.mobility + DECISIVE * self.mobility_std
        return 1.0 / jump if self.mobility > 0 and np.isfinite(jump) else 0.0

    @property
    def late(self) -> bool:
        """Return whether the computer or the answers were too late for a verdict on this doublet."""
        return self.late_edges > 0 and self.edges < LEAST_EDGES


def sign_score(found: Sequence[Response]) -> float:
    """The mobility of several trials together, in standard deviations."""
    weights = [1.0 / r.mobility_std**2 for r in found]
    total = sum(weights)
    if total == 0:
        return 0.0
    score = sum(w * r.mobility for w, r in zip(weights, found, strict=True)) / np.sqrt(total)
    return float(score)


def response(  # noqa: PLR0913 - the columns of one record, and the steps of its sensors
    time: Float64,
    demand: Float64,
    torque: Float64,
    position: Float64,
    *,
    count: float,
    rated: float,
    fresh: Bool | None = None,
    acting: Float64 | None = None,
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
    fresh
        (n,) whether a row's torque and position came with its SYNC; only those are believed.
    acting
        (n,) measured torque around its value at rest with what the drive's own loop gives, where that stays
        closed: a stiff loop drives the axis back before an edge has bent its path. ``None``: the demand acts.
    """
    came = np.ones(demand.size, dtype=bool) if fresh is None else fresh
    late, follow = _lateness(demand, torque, came)
    settled, settled_std = _settled_slope(demand, torque, came, late, rated / 1000)
    amplitude = float(np.abs(demand).max(initial=0.0))
    # 0x6077 steps in thousandths and carries noise of several: below 1 % of rated the slope says nothing
    if amplitude < 0.01 * rated:
        late, follow = 0, float("nan")
        settled, settled_std = float("nan"), float("inf")
    displacement = float(np.abs(position[came]).max(initial=0.0))
    asked = time[demand != 0]
    length = float(asked[-1] - asked[0]) if asked.size > 1 else 0.0
    mobility, std, edges, missed = _edges(time, demand, position, came, count=count, late=late, acting=acting)
    return Response(
        inertia=amplitude * length**2 / (16 * displacement) if displacement > 0 else float("inf"),
        displacement=displacement,
        mobility=mobility,
        mobility_std=std,
        torque_slope=follow,
        stood=_stood(demand, position, came),
        edges=edges,
        late_edges=missed,
        settled_slope=settled,
        settled_std=settled_std,
    )


def without_loop(time: Float64, demand: Float64, torque: Float64, position: Float64, came: Bool) -> Float64:
    """(n,) measured torque less what the drive's own loop gives, where that stays closed under the demand.

    The loop answers the path that it has seen, some cycles of it and its sum; what it gives is told from the
    demand, at any of the first lags, by least squares.
    """
    if came.sum() < 4 * SIDE_ROWS:
        return torque
    lagged = [np.concatenate((np.zeros(k), demand[: demand.size - k])) for k in LAGS]
    past = [
        np.concatenate((np.full(k, position[0]), position[: position.size - k])) for k in (*LAGS, len(LAGS))
    ]
    summed = np.cumsum(position) * np.gradient(time)
    loop = np.stack([*past, summed, np.ones_like(position)], axis=1)
    columns = np.concatenate([np.stack(lagged, axis=1), loop], axis=1)
    scale = np.maximum(np.abs(columns).max(axis=0), 1e-300)
    found = np.linalg.lstsq(columns[came] / scale, torque[came], rcond=None)[0] / scale
    result: Float64 = torque - loop @ found[len(LAGS) :]
    return result


def _stood(demand: Float64, position: Float64, came: Bool) -> bool:
    acting = np.flatnonzero(demand)
    last = position[acting[-(acting.size // 4) :]][came[acting[-(acting.size // 4) :]]]
    return last.size >= SIDE_ROWS and bool(np.all(last == last[0]))


def _lateness(demand: Float64, torque: Float64, came: Bool) -> tuple[int, float]:
    """Cycles by which 0x6077 follows the demand, and its slope there; NaN where no sample came.

    All lags compete: the side lobes of a doublet have the other sign and half the height, so among the first
    few lags alone an answer that comes late would look like a wrong sign.
    """
    seen = np.where(came, torque, 0.0)
    slopes = []
    for k in range(max(1, demand.size // 2)):
        asked = np.where(came[k:], demand[: demand.size - k], 0.0)
        power = float(asked @ asked)
        slopes.append(float(asked @ seen[k:]) / power if power > 0 else 0.0)
    late = int(np.argmax(np.abs(slopes)))
    return late, slopes[late] if slopes[late] != 0 else float("nan")


def _settled_slope(
    demand: Float64, torque: Float64, came: Bool, late: int, step: float
) -> tuple[float, float]:
    """Slope of the torque over the demand and its standard deviation, in the last half of each step.

    There a current loop or a torque slope has done what it does, and only scales are left. ``step`` of
    0x6077 [N·m or N].
    """
    rows: list[int] = []
    edges = [0, *(np.flatnonzero(np.diff(demand) != 0) + 1).tolist(), demand.size]
    for first, end in pairwise(edges):
        if demand[first] != 0 and end - first >= SETTLED_ROWS:
            rows += range((first + end) // 2, end)
    held = np.array(rows, dtype=int)
    held = held[held + late < torque.size]
    held = held[came[held + late]]
    if held.size < SETTLED_ROWS:
        return float("nan"), float("inf")
    asked, shown = demand[held], torque[held + late]
    power = float(asked @ asked)
    slope = float(asked @ shown) / power
    rest = shown - slope * asked
    variance = max(float(rest @ rest) / (held.size - 1), step**2 / 12)
    return slope, float(np.sqrt(variance / power))


def _windows(
    time: Float64, demand: Float64, came: Bool, latest: int
) -> tuple[list[tuple[int, int, int]], int]:
    """(edge, first row, rows) of every edge with punctual samples around it; how many have none.

    Rows are counted without the lag, of which ``latest`` is the largest that will be tried: an edge counts
    for all lags or for none, so that their residuals compare.
    """
    edges = np.flatnonzero(np.diff(demand) != 0) + 1
    if not edges.size:
        return [], 0
    steps = np.diff(time)
    step = float(np.median(steps))
    span = max(5, round(EDGE_S / step))
    ends = [0, *edges.tolist(), demand.size + latest]
    usable, late = [], 0
    for k, edge in enumerate(edges.tolist(), start=1):
        before = min(span, edge - ends[k - 1])
        after = min(span, ends[k + 1] - edge, demand.size - 1 - edge - latest)
        if min(before, after) < SIDE_ROWS:
            continue  # the doublet is too short, nobody was late
        first, last = edge - before, edge + latest + after
        enough = min(came[first:edge].sum(), came[edge + latest + 1 : last + 1].sum()) >= SIDE_ROWS
        # torque acts from the SYNC after it was sent: where that one was late, so was the bend
        prompt = steps[edge - 1 : edge + latest].max(initial=0.0) <= PAUSE * step
        if enough and prompt and time[last] - time[first] <= PAUSE * step * (last - first):
            usable.append((edge, first, before + after + 1))
        else:
            late += 1
    return usable, late


def _edges(  # noqa: PLR0913 - the columns of one record, and how its sensors count
    time: Float64,
    demand: Float64,
    position: Float64,
    came: Bool,
    *,
    count: float,
    late: int,
    acting: Float64 | None,
) -> tuple[float, float, int, int]:
    """Common Δacceleration/Δtorque over all edges and its standard deviation, for the likeliest lag.

    Then how many edges were judged, and at how many somebody was late. ``late``: cycles by which the measured
    torque, and with it ``acting``, follows the demand.
    """
    bent = None if acting is None else _twice_summed(time, acting, came)
    lags = (*LAGS, *(late + k for k in (-2, -1, 0, 1) if late + k > max(LAGS)))
    windows, missed = _windows(time, demand, came, max(lags))
    best, best_rest = (0.0, np.inf), np.inf
    if not windows:
        return *best, 0, missed
    for lag in lags:
        bends, curves = [], []
        for edge, first, rows in windows:
            kept = np.flatnonzero(came[first + lag : first + lag + rows]) + first + lag
            t = time[kept] - time[edge + lag]
            if bent is None:  # the torque from row ``edge`` on bends the path from there on
                bend = 0.5 * np.maximum(t, 0.0) ** 2 * (demand[edge] - demand[edge - 1])
            else:
                bend = bent[np.clip(kept + late - lag, 0, bent.size - 1)]
            basis, _ = np.linalg.qr(np.vander(t / np.abs(t).max(), 4))
            window = position[kept]
            bends.append(bend - basis @ (basis.T @ bend))
            curves.append(window - basis @ (basis.T @ window))
        x, y = np.concatenate(bends), np.concatenate(curves)
        power = float(x @ x)
        if power <= 0:
            continue
        slope = float(x @ y) / power
        rest = y - slope * x
        squares = float(rest @ rest)
        freedom = max(1, y.size - 4 * len(bends) - 1)
        # a step of the encoder is uniform noise of a count over the root of twelve
        variance = max(squares / freedom, count**2 / 12)
        if squares < best_rest:
            best_rest, best = squares, (slope, float(np.sqrt(variance / power)))
    return *best, len(windows), missed


def _twice_summed(time: Float64, torque: Float64, came: Bool) -> Float64:
    """(n,) path of a free unit mass under ``torque``, each row of it acting until the next."""
    steps = np.diff(time, append=2 * time[-1] - time[-2])
    held = np.interp(time, time[came], torque[came]) if came.any() else torque
    speed = np.concatenate([[0.0], np.cumsum(held * steps)[:-1]])
    path: Float64 = np.concatenate([[0.0], np.cumsum((speed + 0.5 * held * steps) * steps)[:-1]])
    return path


def too_late(axis: str, found: Sequence[Response]) -> SafetyStop:
    """Return what to say where the samples of the trials were not punctual enough to accuse anything."""
    late = sum(r.late_edges for r in found)
    total = late + sum(r.edges for r in found)
    return SafetyStop(
        sentence(
            "axis {axis}: could not tell whether torque and encoder agree in sign: at {late} of "
            "{total} steps "
            "of torque in {trials} trials this computer or an answer was late",
            axis=axis,
            late=late,
            total=total,
            trials=len(found),
        ),
        way_out="nothing was recorded yet. Stop other programs on this computer, let it have SCHED_FIFO, or "
        "lengthen bus.cycle_s; then measure again",
        code="computer_late",
        axis=axis,
    )


def judge_scale(axis: str, found: Sequence[Response], *, rated: float, torque_unit: str) -> None:
    """Raise SafetyStop where asked and shown torque do not count in the same unit, over several trials."""
    told = [r for r in found if np.isfinite(r.settled_std)]
    if not told:
        return
    weights = [1.0 / r.settled_std**2 for r in told]
    slope = sum(w * r.settled_slope for w, r in zip(weights, told, strict=True)) / sum(weights)
    if abs(slope - 1.0) <= SCALE + DECISIVE * sum(weights) ** -0.5:
        return
    raise SafetyStop(
        f"axis {axis}: the measured torque (0x6077) is {slope:.3g} times the commanded one (0x6071), and "
        f"both count in thousandths of the rated torque, {rated:.4g} {torque_unit} (0x6076): either the "
        f"drive gives {slope:.3g} times what it is asked for, or one of them counts in the rated current "
        f"(0x6075), as if rated were {rated * slope:.4g} or {rated / slope:.4g} {torque_unit}",
        way_out="compare rated torque and rated current with the motor's plate and correct the wrong one in "
        "the drive",
        code="torque_scale",
        axis=axis,
    )


def judge(axis: str, found: Response, score: float, *, amplitude: float, unit: str, torque_unit: str) -> None:
    """Raise SafetyStop where a sign is wrong."""
    if found.opposed:
        raise SafetyStop(
            f"axis {axis}: the measured torque (0x6077) has the opposite sign of the commanded one (0x6071) "
            f"in a trial at {amplitude:.3g} {torque_unit}",
            way_out="the drive's torque signs disagree: correct its configuration",
            code="signs",
            axis=axis,
        )
    if score < -DECISIVE:
        raise SafetyStop(
            sentence(
                "axis {axis}: positive torque moved the encoder backwards in a trial at "
                "{amplitude:.3g} {torque_unit} ({displacement:.3g} {unit})",
                axis=axis,
                amplitude=amplitude,
                torque_unit=torque_unit,
                displacement=found.displacement,
                unit=unit,
            ),
            way_out="encoder and motor disagree in sign: swap two motor phases or invert the encoder in the "
            "drive (the config's direction turns both and cannot help)",
            code="signs",
            axis=axis,
        )
