"""Fits with a decreasing share of the torque as additional noise (graduated optimisation)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.likelihood.joint_fit import JointFit, fit
from invid.likelihood.placed_effect import Candidate
from invid.numerics.arrays import Float64
from invid.signals.spectral_record import SpectralRecord

NOISE_SHARES = (0.1, 0.01, 0.001, 0.0)
"""Shares of every amplitude that count as noise, fit after fit. Physical: by the sensors' noise a resonance
one line off costs as much as none, with a barrier between; with a tenth of the torque as noise it does
not."""


def fit_tempered(
    here: JointFit,
    train: Sequence[SpectralRecord],
    p: Float64,
    candidate: Candidate,
    shares: Sequence[float] = NOISE_SHARES,
    iterations: int = 60,
) -> JointFit:
    """A fit from ``p`` (n,) with one share of the torque as noise after the other."""
    for share in shares:
        records = [_add_error(r, share) for r in train]
        found = fit(here.layout, records, p, candidate, iterations=iterations, strict=share == 0.0)
        p, candidate = found.p, found.candidate
    return found


def _add_error(record: SpectralRecord, share: float) -> SpectralRecord:
    """The record with a share of its torque as noise."""
    if share == 0.0:
        return record
    error: Float64 = share**2 * np.abs(record.torque) ** 2
    return replace(record, scatter=record.scatter + error)


__all__ = ["NOISE_SHARES", "fit_tempered"]
