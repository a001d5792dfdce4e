"""Records on the same lines, worked on together: one plant, one covariance, one whitening for all of them.

The recorded torque has two parts, each with its own time: what the drive was commanded (E, held over each
sample) and what a known hold gives (H = −Kθ − D·dθ/dt). Their sum acts on the motors,

    A(p) = Σ_parts part·e^{−jωδ}·(1 − s·loss),

δ the part's delay and s the share of it that is held over the sample, loss = 1 − sinc(ωh/2): the amplitude
that holding takes away. Delays count from the middle of the sample where a part is held.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from invid.numerics.arrays import Bool, Complex128, Float64
from invid.signals.record import Record


@dataclass(frozen=True, eq=False)
class Stack:
    """R records on F common lines with the sensors' mean noise.

    Attributes
    ----------
    omega
        (F,) lines [rad/s].
    position
        (R, F, M) amplitudes.
    parts
        (K, R, F, M) parts of the torque that have times of their own: the command, then the hold.
    loop
        (R, F, M) torque per position by which known holds answer; NaN where a hold is not known.
    """

    records: tuple[Record, ...]
    omega: Float64
    position: Complex128
    parts: Complex128
    loop: Complex128
    position_noise: Float64
    torque_noise: Float64
    damping: Float64
    """(M,) of each axis' hold."""

    @property
    def weight(self) -> Float64:
        """(F,) of the lines in the likelihood."""
        return self.records[0].weight

    @property
    def span(self) -> float:
        """T [s]."""
        return self.records[0].span

    @property
    def step(self) -> float:
        """Sampling interval [s]."""
        return self.records[0].step

    @property
    def count(self) -> int:
        """R."""
        return len(self.records)

    @cached_property
    def swing(self) -> Float64:
        """(2,) deviations of the velocity and of the position of the motors that move most."""
        parts = [(r.motion.velocity.std(axis=0), r.motion.position.std(axis=0)) for r in self.records]
        return np.asarray(np.max(parts, axis=(0, 2)), dtype=np.float64)

    @cached_property
    def loss(self) -> Float64:
        """(F, 1) share of its amplitude that a torque loses by being held over the sample."""
        out: Float64 = 1.0 - np.sinc(self.omega * self.step / 2 / np.pi)[:, None]
        return out

    @cached_property
    def wide(self) -> Stack:
        """The same records on all lines up to where motion is known."""
        return _stack(self.records, self.damping, wide=True)

    @cached_property
    def closed(self) -> Bool:
        """(R,) records whose holds are all known."""
        return np.asarray(np.isfinite(self.loop).all(axis=(1, 2)))


def stack_records(records: Sequence[Record], damping: Float64) -> tuple[Stack, ...]:
    """The records in stacks of those with the same lines and instants; ``damping`` (M,) of holds."""
    groups: dict[tuple[float, ...], list[Record]] = {}
    for record in records:
        instants = record.motion.position.shape[0]
        key = (record.span, record.step, record.periods, record.used.size, record.wide.size, instants)
        groups.setdefault(key, []).append(record)
    return tuple(_stack(group, damping) for group in groups.values())


def hold_damping(records: Sequence[Record]) -> Float64:
    """(M,) damping of each axis' hold, read where it is held; zero where it never is."""
    every = np.array([r.hold_damping for r in records])
    seen = np.isfinite(every)
    out: Float64 = np.where(seen, every, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    return out


def _stack(records: Sequence[Record], damping: Float64, *, wide: bool = False) -> Stack:
    omega = records[0].wide if wide else records[0].omega
    position, torque = (
        np.array([lines if wide else lines[r.used] for r, lines in zip(records, part, strict=True)])
        for part in ([r.position for r in records], [r.torque for r in records])
    )
    # Hold and command as they act, not when they are recorded.
    torque = torque * np.exp(1j * omega[:, None] * np.array([r.late for r in records])[:, None, None])
    gain = np.array([r.hold for r in records])
    jump = np.array([r.jump for r in records])
    held = np.where(gain > 0, damping, 0.0)
    loop = gain[:, None] + 1j * omega[:, None] * held[:, None]
    # What a drive's own hold gives is not known apart from its command; a hold that is sampled acts with it.
    sampled = np.array([[r.is_hold_sampled] for r in records])
    known = (np.isfinite(gain) & ~sampled)[:, None]
    hold = np.where(known, -loop * position - (2.0 / records[0].span * held * jump)[:, None], 0.0)
    driven = np.array([r.driven for r in records])[:, None]
    hold = np.where(driven | ~known, hold, torque)
    command = np.array([_command(r, wide) for r in records])
    hold = np.where(np.isfinite(command) & ~sampled[:, None], torque - command, hold)
    return Stack(
        tuple(records),
        omega,
        position,
        np.stack((torque - hold, hold)),
        loop,
        np.array([r.position_noise for r in records]).mean(axis=0),
        np.array([r.torque_noise for r in records]).mean(axis=0),
        damping,
    )


def _command(record: Record, wide: bool) -> Complex128:
    """(F, M) the command on the lines of a stack; NaN where it is not logged."""
    lines = record.command
    if lines is None:
        return np.full((record.wide.size if wide else record.used.size, record.driven.size), np.nan + 0j)
    return lines if wide else lines[record.used]
