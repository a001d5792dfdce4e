"""Axis, frequencies and character of the missing torque that no cause explains."""

from __future__ import annotations

import numpy as np

from invid.diagnosis.evidence import CandidateEvidence
from invid.likelihood.evaluation import Evaluation
from invid.likelihood.null_test import informative_lines
from invid.model.diagnosis_document import Unexplained
from invid.numerics.arrays import Float64
from invid.recording.model import Recording

FOLLOWS = 0.2
"""Share of the missing torque's power from which it is said to follow something. A guess."""


def describe_unexplained(trial: CandidateEvidence, recording: Recording) -> Unexplained:
    """Axis, frequencies and character of the excess of the training and held-out records, in words."""
    motors = recording.axis_count
    power = np.zeros(motors)
    lines: dict[int, list[tuple[float, float]]] = {i: [] for i in range(motors)}
    odd, even, driven = np.zeros(motors), np.zeros(motors), np.zeros(motors)
    levels: list[tuple[float, float]] = []
    for evaluation in (trial.fit.evaluation, trial.held):
        for number, view in enumerate(evaluation.views):
            r = evaluation.missing[number]
            c = np.einsum("fii->fi", evaluation.covariance[number]).real
            usable = informative_lines(evaluation.covariance[number], view.record)
            excess = np.where(usable, np.abs(r) ** 2 / np.maximum(c, 1e-300) - 1.0, 0.0)
            excess[0] *= 0.5
            power += excess.sum(axis=0)
            index = view.record.lines
            is_odd = (index % 2 == 1) & ~view.record.excited
            is_even = (index % 2 == 0) & ~view.record.excited & (index > 0)
            for i in range(motors):
                odd[i] += excess[is_odd, i].sum()
                even[i] += excess[is_even, i].sum()
                driven[i] += excess[view.record.excited, i].sum()
                lines[i] += list(zip((view.omega / 2 / np.pi).tolist(), excess[:, i].tolist(), strict=True))
            size = float(np.std(view.record.motor_wave))
            levels.append(
                (size, float((np.abs(r) ** 2 * usable).sum() / max((np.abs(view.acting) ** 2).sum(), 1e-300)))
            )
    axis = int(np.argmax(power))
    power_by_frequency: dict[float, float] = {}
    for hz, e in lines[axis]:
        key = round(hz, 4)
        power_by_frequency[key] = power_by_frequency.get(key, 0.0) + e
    strongest = sorted(power_by_frequency, key=lambda hz: -power_by_frequency[hz])[:6]
    character = []
    if even[axis] > 0.15 * max(power[axis], 1e-300):
        character.append("even")
    if odd[axis] + driven[axis] > 0.3 * max(power[axis], 1e-300):
        character.append("odd")
    follows = _time_character(trial, axis)
    relative = [share for _, share in sorted(levels)]
    # What changes from record to record by the clock says nothing of their amplitudes.
    if (
        follows != "time-dependent"
        and len(relative) > 1
        and relative[-1] > 0
        and not 0.5 < relative[0] / relative[-1] < 2.0
    ):
        character.append("amplitude-dependent")
    character.append(follows)
    name = recording.axes[axis]
    where = ", ".join(f"{hz:.3g}" for hz in sorted(strongest))
    return Unexplained(
        axis=name,
        frequencies_hz=tuple(sorted(strongest)),
        character=tuple(dict.fromkeys(character)),
        sentence=(
            f"Axis {name}: torque is missing, most at {where} Hz ({', '.join(dict.fromkeys(character))}), "
            "that no cause of the catalogue explains."
        ),
    )


def _time_character(trial: CandidateEvidence, axis: int) -> str:
    """What the missing torque goes with over time: position, velocity, slow time, or none of them.

    Judged by the share of its power in its mean over 24 ranges of position or of velocity, record by record,
    or in the mean and slope of each record. What is constant throughout goes with none.
    """
    waves = [
        (record, _missing_wave(evaluation, number, axis))
        for evaluation in (trial.fit.evaluation, trial.held)
        for number, record in enumerate(evaluation.records)
    ]
    constant = float(np.concatenate([r for _, r in waves]).mean())
    power = {"position-dependent": 0.0, "velocity-dependent": 0.0, "time-dependent": 0.0}
    total = 0.0
    for record, r in waves:
        total += float(np.sum((r - constant) ** 2))
        level = float(r.mean())
        own = r - level
        ramp = np.linspace(-1.0, 1.0, r.size)
        slope = float(own @ ramp) ** 2 / float(ramp @ ramp)
        power["time-dependent"] += r.size * (level - constant) ** 2 + slope
        for name, x in (
            ("position-dependent", record.motor_wave[:, axis]),
            ("velocity-dependent", record.motor_velocity[:, axis]),
        ):
            ranges = np.array_split(own[np.argsort(x)], 24)
            power[name] += float(sum(b.size * b.mean() ** 2 for b in ranges))
    name = max(power, key=lambda k: power[k])
    return name if power[name] > FOLLOWS * max(total, 1e-300) else "amplitude-dependent"


def _missing_wave(evaluation: Evaluation, number: int, axis: int) -> Float64:
    """(n,) missing torque of one record over time, on the lines that say something [N·m or N]."""
    record = evaluation.views[number].record
    half = np.zeros(record.samples // 2 + 1, dtype=complex)
    good = informative_lines(evaluation.covariance[number], record)[:, axis]
    half[record.lines] = np.where(good, evaluation.missing[number][:, axis], 0.0) * (record.samples / 2)
    half[0] *= 2.0  # the line at 0 Hz is the mean itself, others are half of a pair
    out: Float64 = np.fft.irfft(half, record.samples)
    return out
