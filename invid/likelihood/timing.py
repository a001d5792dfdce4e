"""When the parts of the recorded torque act: delay and share held over the sample, of each part and axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from invid.likelihood.stack import Stack
from invid.numerics.arrays import Complex128, Float64

COMMAND, HOLD = 0, 1
"""Parts of the torque (``Stack.parts``)."""
DELAY_PRIOR, SHARE_PRIOR = 0.5, 0.3
"""Standard deviations of a part's delay [samples] and of the share held over the sample: what one sample of
convention leaves open (physical)."""
EXPECTED_SHARE = (1.0, 0.5)
"""Share of a command that is held over the sample, and of a hold, which works inside the drive or outside."""


@dataclass(frozen=True, eq=False)
class Timing:
    """Delays [samples] and held shares (2, M) each: command and hold of each axis."""

    delay: Float64
    share: Float64
    step: float

    @classmethod
    def nominal(cls, motors: int, step: float) -> Timing:
        """Torque at the instants of the position's samples."""
        share = np.repeat(np.array(EXPECTED_SHARE)[:, None], motors, axis=1)
        return cls(np.zeros((2, motors)), share, step)

    @property
    def x(self) -> Float64:
        """(4M,) delays, then shares."""
        return np.concatenate((self.delay.ravel(), self.share.ravel()))

    @property
    def expected(self) -> Float64:
        """(4M,) centre of the prior."""
        return Timing.nominal(self.delay.shape[1], self.step).x

    @property
    def prior(self) -> Float64:
        """(4M,) standard deviations of the prior."""
        size = self.delay.size
        return np.concatenate((np.full(size, DELAY_PRIOR), np.full(size, SHARE_PRIOR)))

    def moved(self, x: Float64) -> Timing:
        """The timing with other numbers (4M,)."""
        half = self.delay.size
        return replace(self, delay=x[:half].reshape(self.delay.shape), share=x[half:].reshape(self.share.shape))

    def acting(self, stack: Stack) -> Complex128:
        """(R, F, M) the torque that acts."""
        return (stack.parts * self._factor(stack)[:, None]).sum(axis=0)

    def slopes(self, stack: Stack) -> Complex128:
        """(R, F, M, 4) its derivative by the delays of command and hold and by their shares, axis by axis."""
        turned = stack.parts * self._factor(stack)[:, None]
        late = -1j * stack.omega[:, None] * self.step * turned
        turn = np.exp(-1j * stack.omega[:, None] * self.step * self.delay[:, None])
        held = -stack.loss * stack.parts * turn[:, None]
        out: Complex128 = np.concatenate((late, held)).transpose(1, 2, 3, 0)
        return out

    def _factor(self, stack: Stack) -> Complex128:
        """(2, F, M)."""
        turn = np.exp(-1j * stack.omega[:, None] * self.step * self.delay[:, None])
        out: Complex128 = turn * (1.0 - self.share[:, None] * stack.loss)
        return out
