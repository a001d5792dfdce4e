"""The reference move as a measured loop makes it, from a record in which its axis stood and was shaken.

With T = q/d the motion of the motor per torque added in closed loop and u the torque that the command alone
asks of the drive (feedforward, and what its gains make of the commanded motion), a motor whose T is another
than the model's misses the command by (T_model − T) u more. T over T_model is measured at the lines that were
shaken, T_model there with all the model's effects at the torque that was added: friction and free play are in
both. Between the lines the ratio is interpolated, below the lowest it stands.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.model.document import Model
from invid.numerics.arrays import Complex128, Float64
from invid.tuning.axis_loop import AxisLoop
from invid.tuning.servo_loop import DriveTiming, speed_response
from invid.tuning.simulated_loops import Command, run_loops

SETTLED = 2
"""Periods of shaking that are simulated; the last counts."""
SURE = 30.0
"""Most that one line weighs, over its deviation: beyond it the model errs (empirical)."""
LATEST_CYCLES = 4.0


@dataclass(frozen=True, eq=False)
class AskedTorque:
    """What the command of one axis asks of its drive: ``torque`` (K,) at ``omega`` (K,) [rad/s], harmonics of
    the whole move of n ``samples``."""

    omega: Float64
    torque: Complex128
    samples: int

    def missed(self, compliance: Complex128) -> Float64:
        """(D, n) by how much less the motor moves for every T_model − T (D, K)."""
        spectrum = np.zeros((compliance.shape[0], self.samples // 2 + 1), dtype=np.complex128)
        spectrum[:, 1 : self.omega.size + 1] = compliance * self.torque
        return np.asarray(np.fft.irfft(spectrum, self.samples, axis=1), dtype=float)


def asked_torque(
    command: Command, axis: int, loop: AxisLoop, timing: DriveTiming, highest: float
) -> AskedTorque:
    """The reference move of one axis as its ``loop`` is told it, up to ``highest`` [rad/s]."""
    rows = [x[:, axis] for x in (command.position, command.velocity, command.acceleration)]
    if loop.shaper is not None:
        rows = [loop.shaper.shape(row, timing.cycle) for row in rows]
    position, speed, forward = (np.fft.rfft(x) for x in (*rows[:2], loop.feedforward.torque(*rows)))
    omega = 2 * math.pi * np.asarray(np.fft.rfftfreq(rows[0].size, timing.cycle), dtype=np.float64)
    kept = slice(1, int(np.searchsorted(omega, highest)))
    gain = loop.gains.position_gain
    missed = gain * position[kept] + speed[kept]
    asked = speed_response(loop.gains, timing, omega[kept]) * missed + forward[kept]
    return AskedTorque(omega[kept], asked, rows[0].size)


def shaken_motion(
    model: Model, loops: Sequence[AxisLoop], timing: DriveTiming, counts: Float64, added: Float64
) -> Float64:
    """(N, M) motors over a period of ``added`` (N, M) torque, with all effects, while the command stands."""
    n, axes = added.shape
    still = np.zeros((SETTLED * n, axes))
    command = Command(still, still, still, 0, 0)
    run = run_loops(model, loops, command, timing, counts, np.tile(added, (SETTLED, 1)))
    return run.motor[-n:]


def lateness(ratio: Complex128, sure: Float64, omega: Float64, cycle: float) -> float:
    """Time [s] by which one of two signals is read later than the other, by their ``ratio`` (F,); lines count
    by how ``sure`` (F,) they are, over their deviation."""
    tried = np.linspace(-LATEST_CYCLES * cycle, LATEST_CYCLES * cycle, 8001)
    score = (np.minimum(sure, SURE) * ratio * np.exp(1j * tried[:, None] * omega)).real.sum(axis=1)
    return float(tried[int(score.argmax())])
