"""The period that a record repeats: the declared one is verified, never trusted."""

from __future__ import annotations

import numpy as np

from invid.numerics.arrays import Float64
from invid.recording.model import Experiment
from invid.recording.period import find_period
from invid.signals.timebase import resample_uniformly
from invid.wording.sentence import sentence

NOT_PERIODIC = 0.3
"""Non-repeating share of the variance above which a declared period is rejected (empirical): noise of half
the signal's power still passes, a wrong period gives about 1."""


def true_period(experiment: Experiment) -> tuple[int, list[str]]:
    """Samples of the period that a record repeats, 0 where it repeats none, and sentences on what was found.

    One whole period is believed.

    Raises
    ------
    RecordingError
        Too few samples, or time that does not increase.
    """
    declared, key = experiment.period_samples, experiment.key
    data = resample_uniformly(experiment)
    said = []
    if data.lost:
        most = sentence(", up to {gap} in a row", gap=data.longest_gap - 1) if data.longest_gap > 2 else ""
        said.append(
            sentence(
                "experiment {experiment}: {lost} of {samples} samples are missing{most}; they "
                "were interpolated",
                experiment=key,
                lost=data.lost,
                samples=data.samples,
                most=most,
            )
        )
    if declared <= 0:
        return 0, said
    if declared > data.samples:
        said.append(
            sentence(
                "experiment {experiment}: the declared period of {declared} samples is longer than "
                "the record ({samples} samples); it is used as one aperiodic record",
                experiment=key,
                declared=declared,
                samples=data.samples,
            )
        )
        return 0, said
    rms = data.torque.std(axis=0)
    named = experiment.excited_axis
    axis = named if 0 <= named < rms.size and rms[named] > 0 else int(np.argmax(rms))
    share = _nonrepeating_share(data.torque[:, axis], declared)
    if share <= NOT_PERIODIC:
        return declared, said
    found = find_period(data.torque[:, axis], repeats=2)
    if found and _nonrepeating_share(data.torque[:, axis], found) < NOT_PERIODIC / 3:
        said.append(
            sentence(
                "experiment {experiment}: the declared period of {declared} samples does not "
                "repeat; the torque repeats every {found} samples, which is used instead",
                experiment=key,
                declared=declared,
                found=found,
            )
        )
        return found, said
    said.append(
        sentence(
            "experiment {experiment}: the declared period of {declared} samples does not "
            "repeat ({share:.0%} of the torque changes from one to the next); the record is "
            "used as aperiodic",
            experiment=key,
            declared=declared,
            share=share,
        )
    )
    return 0, said


def _nonrepeating_share(values: Float64, period: int) -> float:
    """Share of the variance (n,) that differs from one whole period to the next (0 … about 1)."""
    count = values.size // period
    folded = values[values.size - count * period :].reshape(count, period)
    if count < 2:
        return 0.0
    change = np.diff(folded, axis=0)
    change = change - change.mean(axis=1, keepdims=True)
    within = folded - folded.mean(axis=1, keepdims=True)
    return float((change**2).mean() / 2 / max(float((within**2).mean()), 1e-300))
