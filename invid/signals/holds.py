"""Holds within recorded torques: read on lines without a command, else by the command's smoothness."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from invid.numerics.arrays import Complex128, Float64
from invid.numerics.distributions import f_isf
from invid.numerics.linear_algebra import real_rows
from invid.signals.record import DENSE, Record

CHANCE = 1e-6
"""Probability of taking a hold for seen where there is none. Small: a command of random amplitudes is rough
with and without it, and of many lines some hold always smooths a little."""
ROUGHNESS_RATIO = 4.0
"""Factor by which the roughness (mean square) must fall as well (empirical): half in amplitude."""
MOST_ROUGHNESS = 0.35
"""Root mean square of the second differences of log amplitude above which a command is not smooth: lines
whose noise is below a fifth of their amplitude (``SIGNAL_POWER``) have at most √6/5/√2."""
SIGNAL_POWER = 25.0
"""Power over noise of a line that counts."""
MOST_RESIDUAL = 2.0
"""Mean square of what a hold leaves on lines without a command, in units of the noise: 16 lines and more of
pure noise exceed it once in two thousand."""
LEAST_LINES = 16
"""Lines needed at least."""
MOST_GAIN = 1e3
"""Gain of a hold over the largest torque by position: command and hold would be each other but for a
thousandth, which no torque signal tells (physical)."""
DAMPING_STARTS = (0.03, 0.3, 3.0)
"""Dampings P/(ωD) at the middle of the band from which the search starts."""

RecordLines = tuple[Complex128, Complex128, Complex128, Float64]
"""Position, velocity, torque and angular frequency of the lines of a record."""


SURE_HOLD, SILENT_REST = 0.05, 3.0
"""Relative deviation of a hold's stiffness up to which it is known, and power over the torque's noise that it
may leave on lines without a command (empirical, hidden plants with holds inside their drives)."""
FEWEST = 10
"""Fewest lines from which a hold is read."""


def read_holds(records: Sequence[Record]) -> list[Record]:
    """The records with holds inside drives made known that show themselves on lines without a command.

    There the torque is −K·position − D·velocity and nothing else: on the lines between those excited and, of
    an axis that is not driven, on all. Where a hold stays unknown, half a sample h by which it acts at
    another time than the command looks like a viscous friction of K·h/2.
    """
    out = list(records)
    for m in range(records[0].hold.size if records else 0):
        # An axis may be held otherwise while it is driven; where that shows nothing it is held as else.
        seen = [(bool(r.driven[m]), _normal_of_hold(r, m)) for r in records]
        laws = {state: _law_of([found for d, found in seen if d is state]) for state in (False, True)}
        for k, (driven, _) in enumerate(seen):
            law = laws[driven] or laws[not driven]
            if law is not None and np.isnan(out[k].hold[m]):
                out[k] = out[k].with_hold(m, *law)
    return out


def _law_of(seen: Sequence[tuple[Float64, Float64]]) -> tuple[float, float] | None:
    """Stiffness and damping of a hold by normal equations of several records; ``None`` where they are not
    sure."""
    if not seen:
        return None
    normal, pull = (np.sum(part, axis=0) for part in zip(*seen, strict=True))
    if not normal[1, 1]:
        return None
    stiffness, damping = np.linalg.solve(normal, pull)
    if stiffness <= 0.0 or np.sqrt(np.linalg.inv(normal)[0, 0]) > SURE_HOLD * stiffness:
        return None
    return float(stiffness), float(damping)


def _normal_of_hold(record: Record, axis: int) -> tuple[Float64, Float64]:
    """Normal equations (2, 2), (2,) of an unknown hold's stiffness and damping.

    Zero where it does not explain the torque on lines without a command.
    """
    nothing = np.zeros((2, 2)), np.zeros(2)
    excited = record.excited
    free = (record.wide > 0.0) & (record.wide < 2 * np.pi * DENSE * record.top_hz)
    if record.driven[axis]:
        free[excited[excited < free.size]] = False
    if not np.isnan(record.hold[axis]) or (record.driven[axis] and not excited.size) or free.sum() < FEWEST:
        return nothing
    noise = np.sqrt(record.torque_noise[axis] / 2.0)
    position, torque = record.position[free, axis] / noise, record.torque[free, axis] / noise
    velocity = record.velocity(axis, np.flatnonzero(free)) / noise
    columns = -np.stack((position, velocity), axis=1)
    columns, target = (np.concatenate((w.real, w.imag)) for w in (columns, torque))
    normal, pull = columns.T @ columns, columns.T @ target
    size = np.sqrt(np.diag(normal))
    if not size.all() or np.linalg.cond(normal / size / size[:, None]) > 1e10:
        return nothing
    rest = target - columns @ np.linalg.solve(normal, pull)
    return (normal, pull) if float((rest**2).mean()) < SILENT_REST else nothing


def find_smooth_hold(records: Sequence[Record], axis: int) -> tuple[float, float] | None:
    """Gains (P, D) of a hold −(P + jωD)θ within the recorded torque of a driven axis; ``None``: none seen.

    The recorded torque T holds the command and the hold's part. Commands of shaking are designed: their
    amplitude is smooth over frequency, while T alone has the machine's resonances. The hold is that which
    makes |T + (P + jωD)Θ| smoothest. Where the lines are shared out among the axes (interleaved), an axis'
    torque on the lines of the others is its hold's alone.
    """
    by_lines = _without_command(records, axis)
    if by_lines is not None:
        return by_lines
    parts = []
    for r in records:
        lines = r.carrying
        if r.driven[axis] and lines.size >= LEAST_LINES:
            has_signal = lines[np.abs(r.torque[lines, axis]) ** 2 > SIGNAL_POWER * r.torque_noise[axis]]
            if has_signal.size > 0.8 * lines.size:
                parts.append(
                    (r.position[lines, axis], r.velocity(axis, lines), r.torque[lines, axis], r.wide[lines])
                )
    if not parts:
        return None
    count = sum(q.size - 2 for q, *_ in parts)
    without = _roughness(parts, np.zeros(2))
    stiffness = np.concatenate([np.abs(t) / np.maximum(np.abs(q), 1e-300) for q, _, t, _ in parts])
    omega = np.concatenate([np.abs(v) / np.maximum(np.abs(q), 1e-300) for q, v, *_ in parts])
    best = without
    law = np.zeros(2)
    for size in np.quantile(stiffness, (0.05, 0.25, 0.5)):
        for share in DAMPING_STARTS:
            begun = np.array([size * min(share, 1.0), size * min(1.0 / share, 1.0) / np.median(omega)])
            found = np.exp(
                scipy.optimize.least_squares(lambda x: _roughness(parts, np.exp(x)), np.log(begun)).x
            )
            roughness = _roughness(parts, found)
            if roughness @ roughness < best @ best:
                best, law = roughness, found
    before, after = float(without @ without), float(best @ best)
    if not np.all(law >= 0) or not 0 < law[0] < MOST_GAIN * stiffness.max():
        return None  # with a gain without end whatever moves smoothly by itself has a smooth command
    if after > MOST_ROUGHNESS**2 * count:
        return None
    if before < ROUGHNESS_RATIO * after or (before - after) / 2.0 < f_isf(CHANCE, 2, count) * after / count:
        return None
    return float(law[0]), float(law[1])


def _without_command(records: Sequence[Record], axis: int) -> tuple[float, float] | None:
    """The hold from all or every k-th of the lines, where it explains the torque on those to the noise."""
    for r in records:
        if not r.driven[axis]:
            continue
        # All lines, where another axis alone is driven in a record that does not say so.
        for stride in range(1 if r.driven.size > 1 else 2, r.driven.size + 1):
            for first in range(stride):
                lines = r.carrying[first::stride]
                torque, noise = r.torque[lines, axis], r.torque_noise[axis]
                if lines.size < LEAST_LINES or np.mean(np.abs(torque) ** 2) < SIGNAL_POWER * noise:
                    continue
                rows = -np.stack((r.position[lines, axis], r.velocity(axis, lines)), axis=1)
                law = np.linalg.lstsq(real_rows(rows), real_rows(torque), rcond=None)[0]
                gain = law[0] ** 2 + (r.wide[lines] * law[1]) ** 2
                left = np.abs(torque - rows @ law) ** 2 / (noise + gain * r.position_noise[axis])
                if np.all(law >= 0) and law[0] > 0 and np.mean(left) < MOST_RESIDUAL:
                    return float(law[0]), float(law[1])
    return None


def _roughness(parts: Sequence[RecordLines], law: Float64) -> Float64:
    """Second differences of log |T + PΘ + DΩ| between neighbouring lines, corrected for uneven log frequency.

    Commands often fall with a power of frequency. Second differences over the lines alone take that for
    roughness, most at the lowest lines, which determine P: it came out 2.6 times too large.
    """
    out = []
    for position, speed, torque, omega in parts:
        size = np.log(np.maximum(np.abs(torque + law[0] * position + law[1] * speed), 1e-300))
        at = np.log(omega)
        share = (at[1:-1] - at[:-2]) / (at[2:] - at[:-2])
        out.append(2.0 * ((1.0 - share) * size[:-2] + share * size[2:] - size[1:-1]))
    result: Float64 = np.concatenate(out)
    return result
