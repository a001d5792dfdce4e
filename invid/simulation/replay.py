"""Inputs of the simulated plant: the recorded torque, and feedback that ties it to the measured motion.

The recorded torque alone does not hold a free plant in place: its rigid modes integrate every error
twice. The simulated motors are therefore tied to the measured motion by a spring and a damper,

    T = T_recorded − k (θ_sim − θ_meas) − d (θ̇_sim − θ̇_meas),

which is the hold itself where the recording gives its gain (closed loop replayed: k is the gain), and
otherwise a slow observer, two octaves below the lowest excited line, that takes out the rigid drift and
leaves the band alone. A constant torque per axis (offset of the current sensor, friction that holds a
resting motor) is part of that drift and found with the initial state. All are exact in the
discretisation, and T is what the output records, so that the simulated record obeys the model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, savgol_filter, sosfiltfilt

from invid.errors import RecordingError
from invid.model.chains import CoupledChains
from invid.numerics.arrays import Float64
from invid.recording.model import Experiment
from invid.simulation.laws import Laws

_OBSERVER_RATIO = 4.0
"""A quarter of the lowest line: 6 % of the model's error is fed back there, 1 % a factor 2.5 above. Slower
observers let torque noise walk: integrated twice it grows with the cube of the observer's period (case study
at a tenth: 2 to 5 % of the motion)."""
_OBSERVER_DAMPING = 0.7
_DRIFT_RATIO = 0.5
"""Cut of the drift filter over the lowest line: forwards and backwards it takes 1.5 % of the line itself."""
HOLD_DAMPING = 0.3
_MOST_SUBSTEPS = 64


@dataclass(frozen=True, eq=False)
class Drive:
    """Inputs of one experiment on the simulator's fine grid.

    Attributes
    ----------
    time
        (n,) uniform instants [s] of the grid's samples, from the first recorded one.
    step, substeps
        Length of a sub-step [s]; sub-steps between samples.
    stiffness, damping
        (M,) k and d of the tie to the measured motion.
    applied
        ((n − 1)·substeps + 1, M) torque on the motors without the part −k θ_sim − d θ̇_sim.
    measured, rate
        (n, M) measured motion and its derivative at the samples.
    """

    time: Float64
    step: float
    substeps: int
    stiffness: Float64
    damping: Float64
    applied: Float64
    measured: Float64
    rate: Float64

    def refined(self, samples: Float64) -> Float64:
        """Values at the samples on the fine grid of ``applied``."""
        fine = np.linspace(self.time[0], self.time[-1], self.applied.shape[0])
        values: Float64 = CubicSpline(self.time, samples)(fine)
        return values


def drift_torque(error: Float64, given: Drive, chains: CoupledChains, experiment: Experiment) -> Float64:
    """(n, M) torque that takes the drift ``error`` (n, M) below the lowest excited line out.

    Down there the plant is rigid: T = S ë + d ė + k e of the smooth part of the error, filtered without
    phase. It carries no information on the model, as no line lies there; it is the double integral of
    torque noise.
    """
    interval = float(given.time[1] - given.time[0])
    low, _ = band_of(experiment)
    cut = _DRIFT_RATIO * low * 2 * interval
    length = error.shape[0]
    if cut >= 1 or length < 20:
        return np.zeros_like(error)
    filter_ = butter(3, cut, output="sos")
    padding = min(length - 1, int(3 / cut))
    smooth = sosfiltfilt(filter_, error, axis=0, padlen=padding)
    rate = np.gradient(smooth, interval, axis=0)
    acceleration = np.gradient(rate, interval, axis=0)
    stiffness = given.stiffness + chains.ground_springs
    torque: Float64 = acceleration @ chains.rigid_mass_matrix + given.damping * rate + stiffness * smooth
    return torque


def band_of(experiment: Experiment) -> tuple[float, float]:
    """Lowest and highest frequency that the experiment excites [Hz], guessed where it does not say."""
    lines = experiment.frequencies_hz[experiment.frequencies_hz > 0]
    length = max(float(experiment.time[-1] - experiment.time[0]), 1e-9)
    low = float(lines.min()) if lines.size else 5.0 / length
    high = float(lines.max()) if lines.size else experiment.sample_rate_hz / 10
    return max(low, 2.0 / length), min(max(high, low), experiment.sample_rate_hz / 2)


def drive(experiment: Experiment, chains: CoupledChains, laws: Laws, fastest: float) -> Drive:
    """Grid, ties and torques of one experiment; ``fastest`` [rad/s] limits the sub-step of force laws."""
    if experiment.samples < 4:
        raise RecordingError(
            f"experiment {experiment.key}: {experiment.samples} samples; a simulation needs at least 4"
        )
    start, end = float(experiment.time[0]), float(experiment.time[-1])
    interval = float(np.median(np.diff(experiment.time)))
    count = round((end - start) / interval) + 1
    if count > 20 * experiment.samples:
        raise RecordingError(
            f"experiment {experiment.key}: {experiment.samples} samples over {end - start:.6g} s with gaps "
            f"of up to {np.diff(experiment.time).max():.3g} s; split the record at its gaps"
        )
    interval = (end - start) / (count - 1)
    low, high = band_of(experiment)
    # a hundred sub-steps per cycle: piecewise linear input is then right to 3e-4
    wanted = max(1.0, 100 * high * interval)
    if laws.forces or laws.static:
        wanted = max(wanted, interval * fastest / 0.05, interval / 2.5e-4)
    substeps = int(min(np.ceil(wanted), _MOST_SUBSTEPS))
    time = np.linspace(start, end, count)
    fine = np.linspace(start, end, (count - 1) * substeps + 1)
    step = interval / substeps

    sums = np.diag(chains.rigid_mass_matrix)
    gain = np.where(np.isfinite(experiment.hold_gain), experiment.hold_gain, 0.0)
    observer = sums * (2 * np.pi * low / _OBSERVER_RATIO) ** 2
    held = gain > observer
    stiffness = np.where(held, gain, observer)
    ratio = np.where(held, HOLD_DAMPING, _OBSERVER_DAMPING)
    # what the model itself has as a spring to ground needs no tie
    stiffness = np.where(chains.ground_springs > 0, np.where(held, gain, 0.0), stiffness)
    damping = 2 * ratio * np.sqrt(stiffness * sums)

    torque = CubicSpline(experiment.time, experiment.torque)
    motion = CubicSpline(experiment.time, _without_eccentricity(experiment.position, laws))
    rate = CubicSpline(time, _derivative(motion(time), interval, high))
    applied = _apply_actuator(torque, fine, laws, step)
    applied += stiffness * motion(fine) + damping * rate(fine)
    return Drive(time, step, substeps, stiffness, damping, applied, motion(time), rate(time))


def _without_eccentricity(reading: Float64, laws: Laws) -> Float64:
    """True positions behind eccentric encoders; a fixed point that contracts for amplitudes below 1 rad."""
    true: Float64 = reading.copy()
    for i, errors in laws.eccentricity.items():
        for _ in range(30):
            true[:, i] = reading[:, i] - sum(a * np.sin(true[:, i] + phase) for a, phase in errors)
    return true


def _derivative(motion: Float64, interval: float, high: float) -> Float64:
    """Return the derivative smoothed over an eighth of the shortest excited cycle: quantisation is no
    velocity.
    """
    window = 2 * round(1.0 / (16 * high * interval)) + 1
    window = int(np.clip(window, 5, max(5, (motion.shape[0] - 1) // 2 * 2 - 1)))
    if motion.shape[0] <= window:
        slope: Float64 = np.gradient(motion, interval, axis=0)
        return slope
    smooth: Float64 = savgol_filter(motion, window, 3, deriv=1, delta=interval, axis=0)
    return smooth


def _apply_actuator(torque: CubicSpline, fine: Float64, laws: Laws, step: float) -> Float64:
    """Torque that acts: the recorded one delayed, scaled, clipped and lagged, in this order."""
    applied: Float64 = torque(fine)
    for i, delay in laws.delay.items():
        applied[:, i] = torque(np.clip(fine - delay, fine[0], fine[-1]))[:, i]
    for i, gain in laws.gain.items():
        applied[:, i] *= gain
    for i, limit in laws.limit.items():
        applied[:, i] = np.clip(applied[:, i], -limit, limit)
    for i, constant in laws.lag.items():
        decay = float(np.exp(-step / constant))
        # exact for inputs that are linear within a sub-step
        blend = (1.0 - decay) * constant / step
        numerator = np.array([1.0 - blend, blend - decay])
        initial = applied[0, i]
        applied[:, i] = initial + lfilter(numerator, [1.0, -decay], applied[:, i] - initial)
    return applied
