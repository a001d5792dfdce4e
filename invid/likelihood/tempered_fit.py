"""Fits through noise that is a share of the torque, less and less of it (graduated optimisation)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.likelihood.joint_fit import JointFit, fit
from invid.likelihood.placed_effect import Candidate
from invid.numerics.arrays import Float64
from invid.signals.spectral_record import SpectralRecord

ROUGH = (0.1, 0.01, 0.001, 0.0)
"""Share of every amplitude that counts as noise, fit after fit. By the sensors' noise a resonance a line
beside its place is as wrong as none, and the way there is uphill; by a tenth of the torque it is not."""


def fit_tempered(
    here: JointFit,
    train: Sequence[SpectralRecord],
    p: Float64,
    candidate: Candidate,
    shares: Sequence[float] = ROUGH,
    iterations: int = 60,
) -> JointFit:
    """A fit from ``p`` (n,) at one share of the torque after the other."""
    for share in shares:
        records = [_with_error(r, share) for r in train]
        found = fit(here.layout, records, p, candidate, iterations=iterations, strict=share == 0.0)
        p, candidate = found.p, found.candidate
    return found


def _with_error(record: SpectralRecord, share: float) -> SpectralRecord:
    """The record with a share of its torque as noise."""
    if share == 0.0:
        return record
    error: Float64 = share**2 * np.abs(record.torque) ** 2
    return replace(record, scatter=record.scatter + error)


__all__ = ["ROUGH", "fit_tempered"]
