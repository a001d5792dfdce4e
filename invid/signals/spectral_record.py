"""One record on its lines, for the fit of the plant alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from invid.numerics.arrays import Complex128, Float64


@dataclass(frozen=True, eq=False, kw_only=True)
class SpectralLines:
    """One record on the lines of a fit.

    Attributes
    ----------
    omega
        (F,) [rad/s].
    position, torque
        (F, M) complex amplitudes.
    noise
        (F, 2M) noise power of [position; torque].
    span
        Duration [s] that boundary terms are spread over.
    transient
        Whether it has boundary terms: a record that does not close.
    step
        Sample interval [s].
    ends_in
        Whether the spectra hold the end-point correction h/2·(x_n − x_0) that makes a sum the integral.
    integrated
        Whether the position is a velocity's running sum.
    """

    key: str
    omega: Float64
    position: Complex128
    torque: Complex128
    noise: Float64
    span: float
    transient: bool
    step: float
    ends_in: bool = True
    integrated: bool = False

    @cached_property
    def folding(self) -> Images:
        """Images of a torque held over the sample, aliased onto the lines."""
        return Images.of(self.omega, self.step, integrated=self.integrated)


IMAGES = 6
"""Images kept on each side: they fall off with the third power, so the rest is 0.2 % of what they do."""
_ORDERS = np.array([*range(-IMAGES, 0), *range(1, IMAGES + 1)])


@dataclass(frozen=True, eq=False)
class Images:
    """Images of a held torque on given lines, whenever it steps.

    A torque held over samples of length h from t = kh + late has images at ω + kω_s, k ≠ 0. There a chain is
    no more than its motor's mass, the motion is −1/(mΩ²) times the torque, and sampling folds it back:
    E = −(1/m) (1 − e^{−jωh})/(jh) e^{−jω·late} Σ e^{−jkω_s·late}/(ω + kω_s)³. Beside the line's own motion
    it is (ω/ω_s)⁴·6.5: a hundred-thousandth at a thirtieth of the sampling rate, a quarter of a per cent at
    a seventh. A position summed up from a sampled velocity (``integrated``) has the images of the velocity,
    −j/(mΩ), over the line's own jω.
    """

    omega: Float64
    step: float
    zoh_loss: Float64
    """(F,) share of a torque's amplitude that holding it over the sample takes away."""
    each: Complex128
    """(F, images) of every image on every line."""

    @classmethod
    def of(cls, omega: Float64, step: float, *, integrated: bool = False) -> Images:
        """Return the images of samples of length ``step`` [s] on the lines ``omega`` (F,) [rad/s]."""
        image = omega[:, None] + _ORDERS * (2 * np.pi / step)
        cubes = image**-2.0 / np.maximum(omega[:, None], 1e-300) if integrated else image**-3.0
        stepping = (1.0 - np.exp(-1j * omega * step)) / (1j * step)
        return cls(omega, step, 1.0 - np.sinc(omega * step / 2 / np.pi), -stepping[:, None] * cubes)

    def at(self, late: Float64) -> Complex128:
        """(F, M) mass times displacement, over the torque, that folds onto each line.

        ``late`` (M,): how much later than the position's samples each axis' torque steps [s].
        """
        turned = np.exp(-1j * (2 * np.pi / self.step) * _ORDERS[:, None] * late)
        result: Complex128 = np.exp(-1j * self.omega[:, None] * late) * (self.each @ turned)
        return result
