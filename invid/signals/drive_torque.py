"""Commands logged beside a hold inside the drive: the acting torque is known up to one delay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.numerics.arrays import Complex128, Float64
from invid.recording.model import Experiment
from invid.signals.demand import samples_late
from invid.signals.spectra import LineSpectra


def replace_by_acting_torque(
    spectra: Sequence[LineSpectra], experiments: Sequence[Experiment]
) -> tuple[LineSpectra, ...]:
    """Spectra whose torque is the hold's, torque − demand, plus the demand held over the sample.

    Records without a demand, with uneven instants, and those whose torque follows the demand are unchanged.
    """
    known = {e.key: e for e in experiments}
    return tuple(_with_acting_torque(s, known[s.key]) for s in spectra)


def _with_acting_torque(s: LineSpectra, experiment: Experiment) -> LineSpectra:
    demand = experiment.torque_demand
    if demand is None:
        return s
    demand = np.asarray(demand)
    # A record that does not close keeps its last sample for the ends. Periods that still settle are averaged
    # as they are, and so is the demand: the equations are linear.
    if not covers_demand(s, demand):
        return s  # resampled, or cut
    # Without a hold there is nothing beside the demand: what differs is how the drive follows it.
    combined = np.isnan(s.staircase) & np.any(demand != 0, axis=0) & (experiment.hold_gain != 0.0)
    if not combined.any():
        return s
    command = _demand_spectrum(s, demand)
    lines = np.ix_(np.flatnonzero(s.excited), np.flatnonzero(combined))
    shown = s.omega[s.excited], s.position[lines], s.torque[lines]
    delay = samples_late(shown, (command[0] + command[1])[lines], 1.0 / s.sample_rate_hz)
    if delay:  # where the torque is recorded some samples after the demand, so is the demand within it
        demand = np.concatenate((np.repeat(demand[:1], delay, axis=0), demand[:-delay]))
        command = _demand_spectrum(s, demand)
    recorded, ends = command
    half = s.omega / (2 * s.sample_rate_hz)
    held = (np.sinc(half / np.pi) * np.exp(-1j * half))[:, None]
    hold = np.where(combined, s.torque - recorded - ends, 0.0)
    torque = np.where(combined, hold + recorded * held, s.torque)
    stairs = np.where(combined, 0.0, s.staircase)
    return replace(s, torque=torque, staircase=stairs)


def covers_demand(s: LineSpectra, demand: Float64) -> bool:
    """Return whether a demand (samples, M) covers all that the spectra come from; not where it was
    resampled.
    """
    samples = s.periods * s.position_wave.shape[0]
    if s.transient and s.periods == 1:
        return bool(demand.shape[0] == samples + 1)
    return bool(s.periods >= 1 and demand.shape[0] >= samples)


def mean_demand(s: LineSpectra, demand: Float64) -> tuple[Float64, Float64]:
    """(n, M) mean over the periods that the spectra come from, and (M,) what the trapezoid's correction of
    its ends adds to every line of a record that does not close."""
    whole, count = s.transient and s.periods == 1, s.position_wave.shape[0]
    samples = s.periods * count
    used = demand[demand.shape[0] - samples - int(whole) :][:samples]
    ends: Float64 = (demand[-1] - demand[0]) / count if whole else np.zeros(demand.shape[1])
    return used.reshape(s.periods, count, -1).mean(axis=0), ends


def _demand_spectrum(s: LineSpectra, demand: Float64) -> tuple[Complex128, Float64]:
    """(F, M) spectrum of the demand, and (M,) what the trapezoid's correction of its ends adds to it.

    That correction stands in the spectra of a record that does not close; a torque held over the sample
    does not need it.
    """
    count = s.position_wave.shape[0]
    wave, ends = mean_demand(s, demand)
    index = np.rint(s.frequency_hz * count / s.sample_rate_hz).astype(int)
    spectrum: Complex128 = np.fft.rfft(wave, axis=0)[index] * (2.0 / count)
    return spectrum, ends
