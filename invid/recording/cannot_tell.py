"""What a record cannot tell, whatever is fitted to it: a sentence for each, with what was measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import scipy

from invid.numerics.arrays import Float64
from invid.recording.clock import count_slots
from invid.recording.model import Experiment, Recording

AT_LIMIT = 3.0
"""Share of rows near the largest torque over a sinusoid's own from which it is a limit; a multisine has
less."""
NEAR = (1e-3, 0.08)
"""Near: of the largest torque, where it is exact and where it is noisy; at least one step of its numbers."""
MIDDLE = (0.2, 0.8)
"""Between a small torque and the largest, over that: what goes from one to the other passes it (physical)."""
STEADY = 0.3
"""Deviation of the speed over its mean up to which a constant torque is friction at a constant speed."""
STOPS = 0.02
"""Share of the fastest speed up to which an axis stands (noise and quantisation of differences)."""
ALIKE = 1.25
"""Ratio of the 90 % and the 10 % quantile of the peaks of speed up to which all are of one size: a
multisine of three lines or more has above 2."""
ONE_POSE = {"rad": 0.2}
"""Travel within which a weight's torque, k·sin, changes by less than 2 % of k in its shape: (0.1)²/2 each
side."""
SIGNED = 0.01
"""Share of the largest torque that must be negative somewhere for a torque that has a sign."""
GIVES = 0.1
"""Share of the energy to and fro that an axis gives its motor, from which a sign is wrong: friction takes
some, and only what other joints put in could come back. Empirical: none on 23 measured axes whose signs are
right (−0.003 at most), 0.46 and more on four where they are not."""


@dataclass(frozen=True)
class Lack:
    """What a record cannot tell: ``code`` for programs, ``text`` for a person, ``values`` as measured."""

    code: str
    axis: str
    text: str
    values: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Motion:
    """One axis over all experiments; lists of (n,) arrays."""

    unit: str
    position: list[Float64]
    speed: list[Float64]
    torque: list[Float64]


def what_it_cannot_tell(recording: Recording) -> tuple[Lack, ...]:
    """A lack for each axis that moves; in the order of the axes."""
    return tuple(lack for i in range(recording.axis_count) for lack in _of_axis(recording, i))


def _of_axis(recording: Recording, axis: int) -> Iterator[Lack]:
    motion = _Motion(
        recording.position_unit,
        [e.position[:, axis] for e in recording.experiments],
        [_speed(e, axis) for e in recording.experiments],
        [e.torque[:, axis] for e in recording.experiments],
    )
    fastest = max(float(np.abs(v).max(initial=0.0)) for v in motion.speed)
    if fastest <= 0 or _leaps(motion):
        return
    for code, test in _TESTS.items():
        found = test(motion, fastest)
        if found is not None:
            text, values = found
            yield Lack(code, recording.axes[axis], f"{recording.axes[axis]}: {text}", values)


def _leaps(motion: _Motion) -> bool:
    """Whether a torque that is never negative leaps over its middle: a signed number read as unsigned.

    Import says so elsewhere; it shows neither a limit nor a magnitude.
    """
    torque = np.concatenate(motion.torque) / max(float(t.max()) for t in motion.torque)
    return bool(torque.min() >= 0 and not ((torque > MIDDLE[0]) & (torque < MIDDLE[1])).any())


def _speed(e: Experiment, axis: int) -> Float64:
    """(n - 1,) smoothed over as many rows as leave 0.1 % of its travel above the counts of the encoder."""
    slots = count_slots(e.time)
    time = slots.index * slots.step if slots.even else e.time
    position = np.unwrap(e.position[:, axis]) if not slots.lost else e.position[:, axis]
    steps = np.abs(np.diff(position))
    count = float(np.min(steps, initial=np.inf, where=steps > 0))
    usual = float(np.quantile(steps, 0.9)) or count
    rows = int(np.clip(np.nan_to_num(np.ceil(10 * count / usual)), 1, max(position.size // 50, 1)))
    smooth: Float64 = scipy.ndimage.uniform_filter1d(np.diff(position) / np.diff(time), rows)
    return smooth


_Found = tuple[str, dict[str, float]] | None


def _no_reversal(motion: _Motion, fastest: float) -> _Found:
    forth = max(float(v.max(initial=0.0)) for v in motion.speed)
    back = max(float(-v.min(initial=0.0)) for v in motion.speed)
    if min(forth, back) > STOPS * fastest:
        return None
    return (
        "moves in one direction only: dry friction, a constant torque and what differs between directions "
        "cannot be "
        "told apart; record both directions",
        {"fastest_forth": forth, "fastest_back": back},
    )


def _one_amplitude(motion: _Motion, fastest: float) -> _Found:
    peaks = []
    for speed in motion.speed:
        moving = np.sign(np.where(np.abs(speed) > STOPS * fastest, speed, 0.0))
        starts = np.flatnonzero(np.diff(moving, prepend=np.nan) != 0)
        highest = np.maximum.reduceat(np.abs(speed), starts)
        peaks.append(highest[highest > 0.1 * fastest])
    if sum(map(len, peaks)) < 4:
        return None
    low, high = np.quantile(np.concatenate(peaks), (0.1, 0.9))
    if high > ALIKE * low:
        return None
    return (
        f"every swing has one amplitude ({high:.3g} {motion.unit}/s at most): dry friction, viscous "
        "friction and what "
        "depends on the size of a motion (play, a stiffening spring) cannot be told apart; record a second "
        "amplitude",
        {"slowest_swing": float(low), "fastest_swing": float(high)},
    )


def _torque_at_limit(motion: _Motion, fastest: float) -> _Found:
    size = np.abs(np.concatenate([torque[1:] for torque in motion.torque]))
    speed = np.abs(np.concatenate(motion.speed))
    top, levels = float(size.max()), np.unique(size)
    step = float(np.min(np.diff(levels), initial=np.inf)) if 1 < levels.size < 2000 else 0.0
    for near in NEAR:
        band = max(near * top, 1.01 * step)
        close = size >= top - band
        share = float(close.mean())
        if not 0 < band < 0.2 * top or share < max(AT_LIMIT * 2 / np.pi * np.arccos(1 - band / top), 0.02):
            continue
        if float(speed[close].std()) > STEADY * float(speed[close].mean()):
            return (
                f"the torque is at its limit of {top:.4g} for {share:.0%} of the rows: what was asked for "
                "did not act, and a loop that swings there tells little; lower the gains or the amplitude",
                {"limit": top, "share": share},
            )
    return None


def _one_pose(motion: _Motion, fastest: float) -> _Found:
    if motion.unit not in ONE_POSE:
        return None
    travel = max(float(p.max()) for p in motion.position) - min(float(p.min()) for p in motion.position)
    if travel > ONE_POSE[motion.unit]:
        return None
    return (
        f"stays within {travel:.3g} {motion.unit} of one pose: a weight, and what changes with the pose "
        "(inertia, "
        "ripple of fewer cycles a turn), cannot be told from a constant torque; record other poses",
        {"travel": travel},
    )


def _magnitude(motion: _Motion, fastest: float) -> _Found:
    low = min(float(t.min()) for t in motion.torque)
    top = max(float(t.max()) for t in motion.torque)
    # A weight keeps its sign too, but a torque that turns an axis round is zero now and then only by chance.
    touches = sum(int((t <= 0.02 * top).sum()) for t in motion.torque) / sum(t.size for t in motion.torque)
    if top <= 0 or low < -SIGNED * top or touches < 0.005 or _no_reversal(motion, fastest) is not None:
        return None
    return (
        "the torque is never negative while the motion turns: it is a magnitude, and its sign is lost; log "
        "it with its "
        "sign",
        {"least": low, "largest": top},
    )


def _torque_sign(motion: _Motion, fastest: float) -> _Found:
    given = moved = 0.0
    for position, torque in zip(motion.position, motion.torque, strict=True):
        place = np.unwrap(position) if motion.unit == "rad" else position
        steps, acting = np.diff(place), 0.5 * (torque[1:] + torque[:-1])
        # A weight gives back at most what lies between where the record begins and ends.
        given -= float(acting @ steps) + float(np.abs(torque).max()) * abs(float(place[-1] - place[0]))
        moved += float(np.abs(acting * steps).sum())
    if given <= GIVES * moved:
        return None
    return (
        f"the axis gives its motor energy ({given / moved:.0%} of what goes to and fro), and friction takes "
        "it: torque or position has the opposite sign; turn one of the two round (in a map: sign: -1)",
        {"share": given / moved},
    )


_TESTS: Mapping[str, Callable[[_Motion, float], _Found]] = {
    "no_reversal": _no_reversal,
    "one_amplitude": _one_amplitude,
    "torque_at_limit": _torque_at_limit,
    "one_pose": _one_pose,
    "magnitude": _magnitude,
    "torque_sign": _torque_sign,
}
