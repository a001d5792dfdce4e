"""What drives the simulated plant: the recorded torque, and the feedback that keeps it where it was.

The recorded torque alone does not hold a free plant in place: its rigid modes integrate every error
twice. The simulated motors are therefore tied to the measured motion by a spring and a damper,

    T = T_recorded − k (θ_sim − θ_meas) − d (θ̇_sim − θ̇_meas),

which is the hold itself where the recording gives its gain (closed loop replayed: k is the gain), and
otherwise a slow observer, a decade below the lowest excited line, that takes out the rigid drift and
leaves the band alone. Both are exact in the discretisation, and T is what the output records, so that
the simulated record obeys the model exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter, savgol_filter

from invid.arrays import Float64
from invid.chains import CoupledChains
from invid.errors import RecordingError
from invid.recording.model import Experiment
from invid.simulate.laws import Laws

_OBSERVER_BELOW = 10.0  # a decade under the band: 1 % of the model's error is fed back at its edge
_OBSERVER_DAMPING = 0.7
_HOLD_DAMPING = 0.3
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
    recorded, measured, rate
        (n, M) recorded torque, measured motion and its derivative at the samples.
    """

    time: Float64
    step: float
    substeps: int
    stiffness: Float64
    damping: Float64
    applied: Float64
    recorded: Float64
    measured: Float64
    rate: Float64


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
    if laws.forces:
        wanted = max(wanted, interval * fastest / 0.05, interval / 2.5e-4)
    substeps = int(min(np.ceil(wanted), _MOST_SUBSTEPS))
    time = np.linspace(start, end, count)
    fine = np.linspace(start, end, (count - 1) * substeps + 1)
    step = interval / substeps

    sums = np.diag(chains.rigid_mass_matrix)
    gain = np.where(np.isfinite(experiment.hold_gain), experiment.hold_gain, 0.0)
    observer = sums * (2 * np.pi * low / _OBSERVER_BELOW) ** 2
    held = gain > observer
    stiffness = np.where(held, gain, observer)
    ratio = np.where(held, _HOLD_DAMPING, _OBSERVER_DAMPING)
    # what the model itself has as a spring to ground needs no tie
    stiffness = np.where(chains.ground_springs > 0, np.where(held, gain, 0.0), stiffness)
    damping = 2 * ratio * np.sqrt(stiffness * sums)

    torque = CubicSpline(experiment.time, experiment.torque)
    motion = CubicSpline(experiment.time, _without_eccentricity(experiment.position, laws))
    rate = CubicSpline(time, _derivative(motion(time), interval, high))
    applied = _actuator(torque, fine, laws, step)
    applied += stiffness * motion(fine) + damping * rate(fine)
    return Drive(time, step, substeps, stiffness, damping, applied, torque(time), motion(time), rate(time))


def _without_eccentricity(reading: Float64, laws: Laws) -> Float64:
    """True positions behind eccentric encoders; a fixed point that contracts for amplitudes below 1 rad."""
    true: Float64 = reading.copy()
    for i, errors in laws.eccentricity.items():
        for _ in range(30):
            true[:, i] = reading[:, i] - sum(a * np.sin(true[:, i] + phase) for a, phase in errors)
    return true


def _derivative(motion: Float64, interval: float, high: float) -> Float64:
    """Smoothed over an eighth of the shortest excited cycle: quantisation is not a velocity."""
    window = 2 * round(1.0 / (16 * high * interval)) + 1
    window = int(np.clip(window, 5, max(5, (motion.shape[0] - 1) // 2 * 2 - 1)))
    if motion.shape[0] <= window:
        slope: Float64 = np.gradient(motion, interval, axis=0)
        return slope
    smooth: Float64 = savgol_filter(motion, window, 3, deriv=1, delta=interval, axis=0)
    return smooth


def _actuator(torque: CubicSpline, fine: Float64, laws: Laws, step: float) -> Float64:
    """Torque that acts: the recorded one delayed, scaled, clipped and lagged, in this order."""
    applied: Float64 = torque(fine)
    for i, delay in laws.delay.items():
        applied[:, i] = torque(np.clip(fine - delay, fine[0], fine[-1]))[:, i]
    for i, gain in laws.gain.items():
        applied[:, i] *= gain
    for i, limit in laws.limit.items():
        applied[:, i] = np.clip(applied[:, i], -limit, limit)
    for i, constant in laws.lag.items():
        keep = float(np.exp(-step / constant))
        # exact for inputs that are linear within a sub-step
        blend = (1.0 - keep) * constant / step
        numerator = np.array([1.0 - blend, blend - keep])
        begin = applied[0, i]
        applied[:, i] = begin + lfilter(numerator, [1.0, -keep], applied[:, i] - begin)
    return applied
