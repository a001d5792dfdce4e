"""One record on its lines, for every fit; prepared with its motion over time, for a diagnosis."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from invid.numerics.arrays import Complex128, Float64
from invid.signals.standstill import is_seen_standing

FINENESS = 4
"""Points of the fine grid of a motor's motion for one of the waves' grid. Empirical (whole cells at their
true parameters): on the latter reversals are misread by three to seven times the noise, on the fine one by
less than it."""


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


@dataclass(frozen=True, eq=False, kw_only=True)
class SpectralRecord(SpectralLines):
    """One record, prepared: lines (0 Hz first), noise, and what the motors did over time.

    Attributes
    ----------
    lines
        (F,) index of the lines in the transform of the wave; the first is 0, its amplitudes are means.
    filtered
        (F, M) positions with lines that are noise taken out: what effects are evaluated on.
    scatter
        (F, M) variance of r [(N·m)² or N²] that the scatter between periods adds to the sensors' noise.
    motor_wave, motor_velocity, velocity_noise
        (n, M), (n, M), (M,): one period (or the whole record) of the motors, noise filtered out, on a grid
        of interval ``wave_step`` that is no finer than the laws of motion need.
    torque_wave
        (samples, M): torque over the same time, as sampled.
    ramp
        (M,) speed of the line between the record's ends; zero for periodic records.
    command
        (F, M) spectrum of the logged demand where the torque is more than it (a hold beside it).
    set_aside
        (M,) True for axes whose torque in this record no law tells: held, they stand on their friction.
    """

    lines: np.ndarray
    filtered: Complex128
    noise_dof: float
    scatter: Float64
    motor_wave: Float64
    motor_velocity: Float64
    velocity_noise: Float64
    torque_wave: Float64
    wave_step: float
    ramp: Float64
    staircase: Float64
    start_time: float
    end_time: float
    period_time: float
    excited: np.ndarray
    command: Complex128 | None = None
    set_aside: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    weight: Float64 = field(default_factory=lambda: np.zeros(0))
    """(F,) 0 for lines that are left out; empty where all count."""
    alone: bool = False
    """Whether it is a single period of a machine that changes, at its own time."""
    trend: bool = False
    """Whether the missing torque changes over the record's periods, in one direction or at one time."""
    differs: bool = False
    """Whether it scatters from period to period far beyond the sensors' noise."""
    unseen: Float64 = field(default_factory=lambda: np.zeros((0, 0)))
    """(n//2 + 1, M) share of each line of the waves above the band in use that was taken for noise."""
    fine: SpectralRecord | None = None
    """The record with its waves on a finer grid, where laws at the motors are read from it."""

    @property
    def samples(self) -> int:
        """n, of the waves of motion."""
        return int(self.motor_wave.shape[0])

    def on_coarse_grid(self) -> SpectralRecord:
        """The record with its waves on a grid ``FINENESS`` times as wide, and itself beside them."""
        return replace(
            self,
            motor_wave=np.ascontiguousarray(self.motor_wave[::FINENESS]),
            motor_velocity=np.ascontiguousarray(self.motor_velocity[::FINENESS]),
            wave_step=self.wave_step * FINENESS,
            unseen=self.unseen[: self.samples // FINENESS // 2 + 1],
            fine=self,
        )

    def without_fine_grid(self) -> SpectralRecord:
        """The record with its waves alone, whose errors do not show far from the noise."""
        return replace(self, fine=None)

    @cached_property
    def wave_omega(self) -> Float64:
        """(n//2 + 1,) [rad/s] of the waves' own lines."""
        omega = 2 * np.pi * np.fft.rfftfreq(self.samples, self.wave_step)
        return np.asarray(omega, dtype=np.float64)

    @cached_property
    def wave_time(self) -> Float64:
        """(n,) time of the waves of motion, zero in the record's middle [s]."""
        middle = 0.5 * (self.torque_wave.shape[0] - 1) * self.step
        out: Float64 = np.arange(self.samples, dtype=np.float64) * self.wave_step - middle
        return out

    def to_wave(self, lines: Complex128) -> Float64:
        """(n, …) waves of (F, …) amplitudes, the mean first."""
        half = np.zeros((self.samples // 2 + 1, *lines.shape[1:]), dtype=complex)
        half[self.lines] = lines * (self.samples / 2)
        half[0] *= 2.0
        out: Float64 = np.fft.irfft(half, self.samples, axis=0)
        return out

    to_waves = to_wave

    @cached_property
    def law_lines(self) -> dict[Hashable, Complex128]:
        """Lines of laws at motors that follow from the measured motion alone, whatever the plant."""
        return {}

    @cached_property
    def standing(self) -> tuple[bool, ...]:
        """Return whether each motor stands at times; not where noise hides it."""
        noise = self.velocity_noise
        return tuple(is_seen_standing(v, float(noise[i])) for i, v in enumerate(self.motor_velocity.T))

    def unseen_speed(self, torque: Float64, axis: int) -> Float64:
        """(n,) velocity that a ``torque`` (n,) gives one unit of inertia on the lines that noise has hidden.

        A motor turns round with a corner that its friction makes: beyond the band in use that is its own
        inertia's answer, and filtered out with the noise it left three times the noise at 34 dB over it.
        """
        if not self.unseen.size:
            return np.zeros(self.samples)
        lines = np.fft.rfft(torque)
        omega = self.wave_omega
        out: Float64 = np.fft.irfft(
            self.unseen[:, axis] * lines / np.where(omega > 0, 1j * omega, 1.0), self.samples
        )
        return out

    def after(self, time: float) -> float:
        """Share of the record that lies after ``time``."""
        return float(np.clip((self.end_time - time) / (self.end_time - self.start_time), 0.0, 1.0))


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
