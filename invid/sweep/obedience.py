"""Whether an axis goes on moving as its torque has it: demand against motion.

While the amplitude is tried each shaken axis tells how the way in one block of cycles follows from the ways
and the torques of the blocks before:

    y_k = Σ a_j·y_{k-j} + Σ b_j·u_{k-j} + c + e_k        p_k = Σ b_j·u_{k-j}

What the a's leave of y is p_k where the torque acts as it did, -p_k where motor or encoder has changed its
sign, and nothing where the encoder stands or no torque comes. Midway lies no motion by the torque at all:
the log of the likelihood ratio of "nothing" and "as before" is summed as long as it is positive (Page's
cumulative sum), so that little torque takes longer than much, and no length of a window is chosen.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from invid.errors import SafetyStop
from invid.numerics.arrays import Bool, Float64
from invid.sweep.ports import Sample

LONGEST_S, SHARE = 0.016, 0.25
"""A block is so long, and at most that share of the period of the fastest line: the counts of an encoder then
weigh least (empirical, cells of ``tests/machines/ordinary.py`` and the case study)."""
WAYS, TORQUES = 8, 4
"""Blocks that are remembered: two for each of three modes and two to spare, and the delays of drives."""
ROWS = 5 * (WAYS + TORQUES + 1)
"""Fewer blocks do not tell thirteen coefficients."""
SURE = 60.0
"""Log of the likelihood ratio at which the run ends: once in e⁶⁰ blocks, were the rest of the motion white.
In twelve healthy cells (``tests/machines/ordinary.py``, empirical) it came to half of that at most."""
TIMES = 3.0
"""And so many times the largest that came and went by itself: friction makes the rest far from white."""
MOST = 20.0
"""One block decides no more than a third of it: somebody may bump into the axis."""
MEMORY_S = 0.5
"""The rest grows with the torque of the last moments: what it is made of does (friction, modes)."""
LEAST = 0.25
"""Share of the trial's power below which nothing is judged: friction may hold an axis at half its torque."""


@dataclass
class _Axis:
    """What one axis has shown, and where it is."""

    length: int
    """Cycles of a block."""
    ways: list[float]
    torques: list[float]
    offset: float
    rest: float
    """Mean square of e."""
    power: float
    """Mean square of p."""
    recent: float
    fading: float
    y: deque[float] = field(default_factory=lambda: deque(maxlen=WAYS))
    u: deque[float] = field(default_factory=lambda: deque(maxlen=TORQUES))
    place: float | None = None
    cycles: int = 0
    asked: float = 0.0
    ratio: float = 0.0
    highest: float = 0.0
    worst: float = 0.0

    def forget(self) -> None:
        """What comes next follows from nothing before."""
        self.y.clear()
        self.u.clear()
        self.place, self.cycles, self.asked = None, 0, 0.0
        self.ratio = self.highest = 0.0


class Obedience:
    """Demand against motion of each axis whose loop the master closes."""

    def __init__(self, names: Sequence[str], cycle_s: float) -> None:
        self._names, self._cycle = list(names), cycle_s
        self._axes: list[_Axis | None] = [None] * len(names)
        self._slot: int | None = None
        self.paused = False
        """A path is followed: torque is what that takes, against friction."""

    def forget(self) -> None:
        """No cycles were made for a while; what was learned stays."""
        self._slot = None
        for axis in self._axes:
            if axis is not None:
                axis.forget()

    def learn(
        self, i: int, time: Float64, torque: Float64, position: Float64, fresh: Bool, fastest_hz: float
    ) -> None:
        """How axis ``i`` follows, from (n,) rows in which it was shaken with lines up to ``fastest_hz``."""
        block = min(LONGEST_S, SHARE / fastest_hz) if fastest_hz > 0 else LONGEST_S
        length = max(1, round(block / self._cycle))
        ways, torques, rows = _blocks(time, torque, position, fresh, length, self._cycle)
        if len(rows) < ROWS:
            return
        y = np.stack([ways[rows - j] for j in range(1, WAYS + 1)], axis=1)
        u = np.stack([torques[rows - j] for j in range(TORQUES)], axis=1)
        columns = np.concatenate([y, u, np.ones((len(rows), 1))], axis=1)
        scale = np.maximum(np.abs(columns).max(axis=0), 1e-300)
        found = np.linalg.lstsq(columns / scale, ways[rows], rcond=1e-8)[0] / scale
        by_torque = u @ found[WAYS:-1]
        rest = float(np.mean((ways[rows] - columns @ found) ** 2))
        power = float(np.mean(by_torque**2))
        self._axes[i] = _Axis(
            length, found[:WAYS].tolist(), found[WAYS:-1].tolist(), float(found[-1]), max(rest, 1e-300),
            max(power, 1e-300), power, float(np.exp(-length * self._cycle / MEMORY_S)),
        )  # fmt: skip

    def check(self, sample: Sample, asked: Sequence[float]) -> None:
        """SafetyStop where an axis no longer moves as its torque has it."""
        if self.paused or (self._slot is not None and sample.slot != self._slot + 1):
            self.forget()  # the drive went on with its last torque meanwhile
        self._slot = sample.slot
        for i, axis in enumerate(self._axes):
            if axis is None:
                continue
            if axis.cycles == axis.length or axis.place is None:
                self._end(i, axis, sample)
            axis.asked += asked[i]
            axis.cycles += 1

    def _end(self, i: int, axis: _Axis, sample: Sample) -> None:
        """A block is over where this sample was taken."""
        torque, before = axis.asked / axis.length, axis.place
        if not sample.fresh[i] or (before is not None and torque == 0.0):
            axis.forget()
            return
        axis.place, axis.asked, axis.cycles = sample.position[i], 0.0, 0
        if before is None:
            return
        way = sample.position[i] - before
        axis.u.appendleft(torque)
        if len(axis.y) == WAYS and len(axis.u) == TORQUES:
            self._judge(i, axis, way)
        axis.y.appendleft(way)

    def _judge(self, i: int, axis: _Axis, way: float) -> None:
        by_torque = sum(b * u for b, u in zip(axis.torques, axis.u, strict=True))
        left = way - axis.offset - sum(a * y for a, y in zip(axis.ways, axis.y, strict=True))
        power = by_torque * by_torque
        axis.recent = max(power, axis.fading * axis.recent + (1.0 - axis.fading) * power)
        if axis.recent < LEAST * axis.power:
            axis.ratio = axis.highest = 0.0
            return
        rest = axis.rest * max(1.0, axis.recent / axis.power)
        axis.ratio = max(0.0, axis.ratio + min(MOST, (power - 2.0 * left * by_torque) / (2.0 * rest)))
        axis.highest = max(axis.highest, axis.ratio)
        if axis.ratio == 0.0:
            axis.worst, axis.highest = max(axis.worst, axis.highest), 0.0
        if axis.ratio > max(SURE, TIMES * axis.worst):
            raise SafetyStop(
                f"axis {self._names[i]}: it moved as its torque had it and does so no longer",
                way_out="a sign has turned in motor or encoder, the encoder is stuck, or something holds the "
                "axis: find out before anything moves again",
                code="disobeys",
                axis=self._names[i],
            )


def _blocks(
    time: Float64, torque: Float64, position: Float64, fresh: Bool, length: int, cycle_s: float
) -> tuple[Float64, Float64, np.ndarray]:
    """Way and mean torque of each block, and the blocks before which enough others came without a gap."""
    count = (time.size - 1) // length
    ends = np.arange(count + 1) * length
    ways = np.diff(position[ends])
    means = torque[: count * length].reshape(count, length).mean(axis=1)
    late = np.concatenate([[0], np.cumsum(np.diff(time) > 1.5 * cycle_s)])
    whole = (np.diff(late[ends]) == 0) & fresh[ends[:-1]] & fresh[ends[1:]] & (means != 0.0)
    before = max(WAYS, TORQUES - 1)
    since = np.cumsum(whole)
    rows = np.array(
        [k for k in range(before, count) if since[k] - since[k - before] == before and whole[k - before]]
    )
    return ways, means, rows.astype(int)
