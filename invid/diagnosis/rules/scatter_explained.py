"""Scatter between periods that a cause made: noise no longer, once the cause is in the model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from invid.likelihood.evaluation import Evaluation, numbers_on
from invid.numerics.arrays import Float64
from invid.signals.spectral_record import Record

LOW = 6.0
"""Standard deviations of χ² by which a record has to stay below its expectation; chance does not."""


def quieted(part: Evaluation) -> list[Record]:
    """The records of a fit, with as much of their scatter as what the fit leaves asks for.

    A spring that drifts, or friction from rest, makes periods differ, and without the cause that counts as
    noise. With the cause χ² was 44 of 1287: standard deviations ten times too large, and whatever else is
    wrong below that unseen.
    """
    out = []
    for number, view in enumerate(part.views):
        record = view.record
        if not record.scatter.any() or record.alone:
            out.append(record)
            continue
        share = _share(part, number)
        if share == 1.0:
            out.append(record)
            continue
        out.append(replace(record, scatter=share * record.scatter, differs=record.differs and share > 0.0))
    return out


def _share(part: Evaluation, number: int) -> float:
    """Of the scatter of a record, so that χ² is what is expected; one where it is not far below."""
    record, missing = part.views[number].record, part.missing[number]
    rows = numbers_on(record, part.roots[number])
    seen = rows > 0
    rows = rows[seen]
    count = float(rows.sum()) * missing.shape[1] - part.bases[number].shape[1]
    added = record.scatter[seen]
    sensors = part.covariance[number][seen] - added[:, :, None] * np.eye(missing.shape[1])

    def cost(share: float) -> float:
        whole = sensors + share * added[:, :, None] * np.eye(missing.shape[1])
        solved = np.linalg.solve(whole, missing[seen][..., None])[..., 0]
        power: Float64 = np.einsum("fi,fi->f", missing[seen].conj(), solved).real
        return float(rows @ power)

    if cost(1.0) > count - LOW * np.sqrt(2.0 * max(count, 1.0)):
        return 1.0
    if cost(0.0) <= count:
        return 0.0
    return float(brentq(lambda share: cost(share) - count, 0.0, 1.0, xtol=1e-9))


__all__ = ["quieted"]
