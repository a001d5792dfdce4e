"""Line spectra of an experiment with the noise covariance that the recording itself reveals."""

from __future__ import annotations

from dataclasses import dataclass, field

from invid.arrays import Bool, Complex128, Float64
from invid.recording.model import Role


@dataclass(frozen=True, eq=False)
class LineSpectra:
    """Averaged spectra of one experiment on F lines (excited or not).

    Convention: X_k = (2/n) Σ_t x(t) e^{−jω_k t}, so that |X_k| is the amplitude of a sinusoid.

    Attributes
    ----------
    frequency_hz
        (F,) lines, ascending, without 0.
    position, torque
        (F, M) complex amplitudes [rad or m], [N·m or N], averaged over periods.
    covariance
        (F, 2M, 2M) complex covariance E[n nᴴ] of the *averaged* n = [position noise; torque noise].
    covariance_dof
        (F,) real degrees of freedom behind each covariance (for Hotelling's inflation).
    excited
        (F,) True on lines that the excitation drives.
    transient
        True where the record is not periodic steady state (from rest, aperiodic): fits must add the
        boundary terms of every coordinate (see ``docs/reference/equations.md``).
    time, position_wave, torque_wave
        (n,), (n, M), (n, M): the averaged period (or the whole record), sampled uniformly: what
        effects are evaluated on.
    """

    key: str
    role: Role
    frequency_hz: Float64
    position: Complex128
    torque: Complex128
    covariance: Complex128
    covariance_dof: Float64
    excited: Bool
    periods: int
    sample_rate_hz: float
    transient: bool
    time: Float64
    position_wave: Float64
    torque_wave: Float64
    warnings: tuple[str, ...] = field(default=())
