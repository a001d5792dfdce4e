"""From the recorded torque to the one that acts: delay and held share of each part, lag of each axis.

A part of the torque (``Stack.parts``: command and hold) acts as

    part·e^{−jωhδ}·(1 − s·loss)·L(λ),   L = 1/(1 + jωhλ) for λ ≥ 0, 1 − jωhλ for λ < 0,

with the delay δ and the lag λ in samples of h, and the share s that is held over the sample. A drive that
lags has λ > 0; where what it shows of its torque is low-passed, λ < 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.likelihood.unknown_forces.stack import Stack
from invid.numerics.arrays import Complex128, Float64

COMMAND, HOLD = 0, 1
"""Parts of the torque."""
DELAY_PRIOR, SHARE_PRIOR = (0.5, 0.35), 0.5
"""Standard deviations of each part's delay [samples] and of the share held over the sample: what one sample
of convention leaves open (physical)."""
NO_LAG = 1e-9
"""Standard deviation of a lag that is not supposed."""
EXPECTED_DELAY = (-0.5, -0.25)
"""Delay [samples] of a command, which acts over the sample before the SYNC that shows it, and of a hold,
which acts with it or at the SYNC."""
CONVENTION = 1.5
"""Delay of either sign [samples] that conventions make: half a sample of holding, and one between the command
that is shown and the one that acts."""
EXPECTED_SHARE = (0.5, 0.5)
"""Share of either part that is held over the sample: a record may have fewer samples than its drive."""
SAMPLED = (1.0, 0.3)
"""The same of what a master commands once a sample, and its deviation, which a drive's loop leaves open."""


@dataclass(frozen=True, eq=False)
class Timing:
    """Delays [samples] and held shares (2, M), command and hold of each axis; lags (M,) [samples]."""

    delay: Float64
    share: Float64
    lag: Float64
    step: float
    is_sampled: bool = False
    """Whether the records say that all torque is commanded once a sample."""

    @classmethod
    def nominal(cls, motors: int, step: float, *, is_sampled: bool = False) -> Timing:
        """What a drive shows at a SYNC of the command acted over the sample before it, of its hold at it."""
        expected_share = (SAMPLED[0], SAMPLED[0]) if is_sampled else EXPECTED_SHARE
        delay, share = (
            np.repeat(np.array(v)[:, None], motors, axis=1) for v in (EXPECTED_DELAY, expected_share)
        )
        return cls(delay, share, np.zeros(motors), step, is_sampled)

    @classmethod
    def of_records(cls, stacks: Sequence[Stack]) -> Timing:
        """As ``nominal``, by what records say of how they are commanded."""
        sampled = all(r.is_hold_sampled for s in stacks for r in s.records)
        return cls.nominal(stacks[0].position.shape[2], stacks[0].step, is_sampled=sampled)

    @property
    def motors(self) -> int:
        """M."""
        return int(self.lag.size)

    @property
    def x(self) -> Float64:
        """(5M,) delays, shares, lags."""
        return np.concatenate((self.delay.ravel(), self.share.ravel(), self.lag))

    @property
    def expected(self) -> Float64:
        """(5M,) centre of the prior."""
        return Timing.nominal(self.motors, self.step, is_sampled=self.is_sampled).x

    @property
    def prior(self) -> Float64:
        """(5M,) standard deviations of the prior."""
        size = 2 * self.motors
        return np.concatenate(
            (
                np.repeat(np.array(DELAY_PRIOR), self.motors),
                np.full(size, SAMPLED[1] if self.is_sampled else SHARE_PRIOR),
                np.full(self.motors, NO_LAG),
            )
        )

    def moved(self, x: Float64) -> Timing:
        """The timing with other numbers (5M,)."""
        size, shape = 2 * self.motors, self.delay.shape
        return replace(
            self,
            delay=x[:size].reshape(shape),
            share=x[size : 2 * size].reshape(shape),
            lag=x[2 * size :],
        )

    def punctual(self, axis: int) -> Timing:
        """The timing with an axis' delays as they are expected."""
        delay = self.delay.copy()
        delay[:, axis] = EXPECTED_DELAY
        return replace(self, delay=delay)

    def acting(self, stack: Stack) -> Complex128:
        """(R, F, M) the torque that acts."""
        out: Complex128 = self._parts(stack).sum(axis=0)
        return out

    def slopes(self, stack: Stack) -> Complex128:
        """(R, F, M, 5) its derivative by an axis' delays of command and hold, their shares, and the lag."""
        parts = self._parts(stack)
        turn = 1j * stack.omega[:, None] * self.step
        late = -turn * parts
        held = -stack.loss * stack.parts * (self._turn(stack) * self._lagging(stack))[:, None]
        lagging = -turn / (1.0 + turn * np.abs(self.lag)) * parts.sum(axis=0)
        out: Complex128 = np.concatenate((late, held, lagging[None])).transpose(1, 2, 3, 0)
        return out

    def _turn(self, stack: Stack) -> Complex128:
        """(2, F, M)."""
        out: Complex128 = np.exp(-1j * stack.omega[:, None] * self.step * self.delay[:, None])
        return out

    def _parts(self, stack: Stack) -> Complex128:
        """(2, R, F, M)."""
        factor = self._turn(stack) * (1.0 - self.share[:, None] * stack.loss) * self._lagging(stack)
        out: Complex128 = stack.parts * factor[:, None]
        return out

    def _lagging(self, stack: Stack) -> Complex128:
        """(F, M) what the lag makes of the torque."""
        turn = 1.0 + 1j * stack.omega[:, None] * self.step * np.abs(self.lag)
        return np.where(self.lag < 0.0, turn, 1.0 / turn)
