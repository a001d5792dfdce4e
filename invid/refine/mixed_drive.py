"""Commands logged beside a hold inside the drive: the acting torque is known up to one delay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.recording.model import Experiment
from invid.spectra import LineSpectra


def with_acting_torque(
    spectra: Sequence[LineSpectra], experiments: Sequence[Experiment]
) -> tuple[LineSpectra, ...]:
    """Spectra whose torque is the hold's, torque − demand, plus the demand held over the sample.

    Records without a demand, unsettled ones, and those whose torque follows the demand are as they were.
    """
    known = {e.key: e for e in experiments}
    return tuple(_acting(s, known[s.key]) for s in spectra)


def _acting(s: LineSpectra, experiment: Experiment) -> LineSpectra:
    demand, count = experiment.torque_demand, s.position_wave.shape[0]
    if demand is None or s.transient or s.periods < 1:
        return s
    demand = np.asarray(demand)
    if demand.shape[0] < s.periods * count or demand.shape[0] != experiment.samples:
        return s
    mixed = np.isnan(s.staircase) & np.any(demand != 0, axis=0)
    wave = demand[demand.shape[0] - s.periods * count :].reshape(s.periods, count, -1).mean(axis=0)
    index = np.rint(s.frequency_hz * count / s.sample_rate_hz).astype(int)
    command = np.fft.rfft(wave, axis=0)[index] * (2.0 / count)
    half = s.omega / (2 * s.sample_rate_hz)
    held = (np.sinc(half / np.pi) * np.exp(-1j * half))[:, None]
    torque = np.where(mixed, s.torque + command * (held - 1.0), s.torque)
    hold = np.where(mixed, s.torque - command, 0.0)
    return replace(s, torque=torque, staircase=np.where(mixed, 0.0, s.staircase), hold_torque=hold)
