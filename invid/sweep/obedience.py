"""Whether an axis goes on moving as its torque has it, or the opposite way: demand against motion.

While the amplitude is tried each shaken axis tells how the way in one block of cycles follows from the ways
and the torques of the blocks before:

    y_k = Σ a_j·y_{k-j} + Σ b_j·u_{k-j} + c + e_k        p_k = Σ b_j·u_{k-j}

What the a's leave of y is p_k + e_k where the torque acts as it did, and -p_k + e_k where motor or encoder
has changed its sign. What other axes, friction and springs add to e is not known and grows with the torque,
so no variance is believed: over the last n blocks the log of the likelihood ratio of the two signs, each
with the variance that these blocks show for it, is n/2·ln(Σ(left - p)² / Σ(left + p)²). An axis that
friction holds leaves nothing, which speaks for neither.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from invid.errors import SafetyStop
from invid.numerics.arrays import Bool, Float64
from invid.sweep.ports import Sample
from invid.wording.sentence import sentence

LONGEST_S, SHARE = 0.016, 0.25
"""A block is so long, and at most that share of the period of the fastest line: the counts of an encoder then
weigh least (empirical, cells of ``tests/machines/cells.py`` and the case study)."""
WAYS, TORQUES = 8, 4
"""Blocks that are remembered: two for each of three modes and two to spare, and the delays of drives."""
ROWS = 5 * (WAYS + TORQUES + 1)
"""Fewer blocks do not tell thirteen coefficients."""
LENGTHS = (10, 16, 24, 32)
"""Blocks over which signs are compared: strong torque is told soon, weak later. Over more of them a few wild
moments count as evidence (empirical, the same cells)."""
SURE = 30.0
"""Log of the likelihood ratio at which the run ends: the known sign leaves at least six times (over 32
blocks) what the other leaves. Empirical: in 128 axes of ``tests/machines/cells.py`` (friction, loads,
up to six that are coupled) 15 at most, with a mean excess over 9 of 3; 8 in ordinary cells."""


@dataclass
class _Axis:
    """What one axis has shown, and where it is."""

    length: int
    """Cycles of a block."""
    ways: list[float]
    torques: list[float]
    offset: float
    rest: float
    """Mean square of e in the trial; no sign leaves less."""
    y: deque[float] = field(default_factory=lambda: deque(maxlen=WAYS))
    u: deque[float] = field(default_factory=lambda: deque(maxlen=TORQUES))
    place: float | None = None
    cycles: int = 0
    asked: float = 0.0
    same: deque[float] = field(default_factory=lambda: deque(maxlen=LENGTHS[-1]))
    """Squares of what the known sign leaves."""
    other: deque[float] = field(default_factory=lambda: deque(maxlen=LENGTHS[-1]))

    def forget(self) -> None:
        """What comes next follows from nothing before."""
        for past in (self.y, self.u, self.same, self.other):
            past.clear()
        self.place, self.cycles, self.asked = None, 0, 0.0

    def turned(self) -> float:
        """Log of the likelihood ratio of the other sign and the known one."""
        same = other = found = 0.0
        for n, (s, o) in enumerate(zip(reversed(self.same), reversed(self.other), strict=True), start=1):
            same, other = same + s, other + o
            if n in LENGTHS and same > other:
                found = max(found, 0.5 * n * math.log(same / max(other, n * self.rest)))
        return found


class Obedience:
    """Demand against motion of each axis whose loop the master closes."""

    def __init__(self, names: Sequence[str], cycle_s: float) -> None:
        self._names, self._cycle = list(names), cycle_s
        self._slot: int | None = None
        self._learned: dict[frozenset[int], list[_Axis | None]] = {}
        """By the axes that were shaken: how one follows depends on what the others do meanwhile."""
        self._axes: list[_Axis | None] = []
        self.shake(())
        self.paused = False
        """A path is followed: torque is what that takes, against friction."""

    def shake(self, axes: Iterable[int]) -> None:
        """From here on these axes are shaken, the others held."""
        learned = self._learned.setdefault(frozenset(axes), [None] * len(self._names))
        if learned is not self._axes:
            self._axes = learned
            self.forget()

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
        rest = float(np.mean((ways[rows] - columns @ found) ** 2))
        self._axes[i] = _Axis(
            length, found[:WAYS].tolist(), found[WAYS:-1].tolist(), float(found[-1]), max(rest, 1e-300)
        )

    def check(self, sample: Sample, asked: Sequence[float]) -> None:
        """SafetyStop where an axis goes against its torque."""
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
        axis.same.append((left - by_torque) ** 2)
        axis.other.append((left + by_torque) ** 2)
        if axis.turned() > SURE:
            raise SafetyStop(
                sentence(
                    "axis {axis}: it moved as its torque had it and now goes the opposite way",
                    axis=self._names[i],
                ),
                way_out="a sign has turned in motor or encoder: find out before anything moves again",
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
