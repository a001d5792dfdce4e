"""Periodic records taken whole, where a machine does not do the same in every period.

A law of motion is no linear thing: its mean over periods that differ is not what it gives on their mean, and
what it gives otherwise in each of them passes for noise. Taken whole, with the ends of a record that does not
close, such a record is as exact as any other, and the scatter is what the laws are told from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.diagnosis.evidence import Trial
from invid.diagnosis.thresholds import NAMED_SHARE
from invid.likelihood.evaluation import Evaluation, numbers_on
from invid.likelihood.joint_fit import JointFit, held_out
from invid.likelihood.null_test import DIFFERS
from invid.recording.model import Recording
from invid.signals.spectral_record import Record


def unfolded(recording: Recording) -> Recording:
    """The recording with every experiment as one record without a period."""
    experiments = tuple(replace(e, period_samples=0) for e in recording.experiments)
    return replace(recording, experiments=experiments)


def scatter_in(part: Evaluation) -> float:
    """Power of the scatter between periods over that of the sensors' noise, in the records that scatter."""
    ratios = []
    for view, covariance, root in zip(part.views, part.covariance, part.roots, strict=True):
        record = view.record
        if record.alone or not record.scatter.any():
            continue
        seen = numbers_on(record, root) > 0
        seen[0] = False
        own = np.einsum("fii->fi", covariance).real - record.scatter
        ratios.append(float(np.mean(record.scatter[seen] / np.maximum(own[seen], 1e-300))))
    return float(np.mean(ratios)) if ratios else 0.0


def differ(fit: JointFit, held: Sequence[Record]) -> float:
    """That of the training and the held-out records; zero where their periods are alike but for noise."""
    level = max(scatter_in(fit.evaluation), scatter_in(held_out(fit, held)))
    return level if level > DIFFERS else 0.0


def is_explained(final: Trial, scatter: float) -> bool:
    """Whether the laws leave a tenth of the ``scatter`` (over the sensors' noise) at most.

    Noise of the torque or a disturbance, which no law of the motion gives, stays in whole records as it was.
    """
    return final.excess < (1.0 - NAMED_SHARE) * scatter * final.dof


def is_nearer(whole: Trial, other: JointFit) -> bool:
    """Whether a fit to whole records is nearer than the ``other`` to those of them that neither was fitted
    to."""
    records = whole.held.records
    return whole.held.cost < held_out(other, records).cost
