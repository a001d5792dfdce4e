"""Dropped samples: rows that repeat the one before more often than noise lets them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d
from scipy.special import erfinv

from invid.diagnosis.outcome import explained_share, left_over, verdict_of
from invid.diagnosis.validation import split_records
from invid.effects.registry import BY_CAUSE
from invid.effects.units import unit_of
from invid.likelihood.joint_fit import JointFit, evaluate_held_out
from invid.likelihood.null_test import rms_torque
from invid.model.diagnosis_document import Diagnosis, Finding, Verdict
from invid.model.document import EffectTerm, Estimate
from invid.numerics.arrays import Bool, Float64
from invid.numerics.distributions import binomial_sf
from invid.recording.model import Experiment, Recording
from invid.signals.spectra import all_spectra

FALSE_ALARM = 1e-4
"""Chance, over all axes, that repeated rows of a sound recording are called dropped."""
FAST = 0.05
"""Chance that a position repeats below which it is too fast for that. A guess: what is slower is left out, so
nothing but sensitivity on held axes depends on it."""
ALIKE = 2.0
"""Times that a rounded signal may repeat more or less often than its speed and noise say. A guess."""
NEARLY = 0.2
"""Share of the rows that repeat by chance by which their number may be wrong. Empirical: on eight hidden
records it was half to once of it where there were few and within a tenth where there were many."""
RARE = 0.3
"""Chance of a row to repeat, over the share lost, up to which it hardly does. A guess: of all rows and these
alone those count that tell the share better."""
NODES = np.sqrt(2.0) * erfinv(np.linspace(-0.975, 0.975, 40))
"""Standard normal deviates of equal weight."""


@dataclass(frozen=True)
class DroppedRows:
    """Share of the rows of one axis that were dropped, with its standard deviation."""

    axis: int
    fraction: float
    std: float


def _repeats(e: Experiment, axis: int) -> tuple[Bool, Float64, Float64]:
    """(n − 1,) rows whose position and torque both repeat exactly, how likely that is by chance at most, and
    how likely it is.

    Chance: the product of how often each channel alone repeats nearby (quantised channels do), over
    a second either side, which leaves out that both were lost together; or of how often they do where both
    turn round, as those of a slow sinusoid do at once. The torque of an axis that is held follows from its
    position and repeats with it: there only rows count at which the position is too fast to repeat, the
    others have no chance (NaN).
    """
    steps_p, steps_t = np.diff(e.position[:, axis]), np.diff(e.torque[:, axis])
    same_p, same_t = steps_p == 0, steps_t == 0
    both: Bool = same_p & same_t
    window = max(min(int(e.sample_rate_hz), both.size // 4), 8)

    def near(flags: Bool) -> Float64:
        # Of the rows that are not repeated as a whole: what a channel does by itself.
        alone = uniform_filter1d((flags & ~both).astype(float), window, mode="constant")
        rest = uniform_filter1d((~both).astype(float), window, mode="constant")
        out: Float64 = alone / np.maximum(rest, 1.0 / window)
        return out

    p, t = near(same_p), near(same_t)
    # P(both) = P(p)·P(t) for independent channels, from P(p and not t) = P(p)(1 − P(t)) and so on.
    chance: Float64 = np.clip(p * t / np.maximum(1.0 - p - t + p * t, 1e-6) * (1 + p + t), 0.0, 1.0)
    slow = _slow(steps_p)
    if e.excited_axis not in (-1, axis):
        most = np.where(slow > FAST, np.nan, np.maximum(chance, slow))
        return both, most, most
    slow_t = _slow(steps_t)
    most = np.maximum(chance, slow * slow_t)
    return both, most, _at_once((slow, slow_t), (same_p & ~both, same_t & ~both), most)


def _at_once(slow: tuple[Float64, Float64], alone: tuple[Bool, Bool], most: Float64) -> Float64:
    """(n − 1,) chance that two rounded signals repeat at once, each as often as it does alone.

    The larger of two estimates row by row is more than either: it made 0.9 % of 1.4 % lost
    in one hidden case. Where the signals do not repeat as rounded ones do there is no better.
    """
    out: Float64 = slow[0] * slow[1]
    for own, other, seen in zip(slow, slow[::-1], alone, strict=True):
        told = float((own * (1.0 - other)).sum())
        if told <= 0.0 or not 1.0 / ALIKE < seen.sum() / told < ALIKE:
            return most
        out = out * float(seen.sum() / told)
    return np.minimum(out, most)


def _slow(steps: Float64) -> Float64:
    """(n − 1,) chance that a rounded signal repeats, from how fast it goes around each row and its noise.

    Rounded to q, a signal that moves by d from row to row stays in its step with the chance 1 − |d|/q.
    """
    moved = np.abs(steps)
    if not moved.any():
        return np.ones_like(steps)
    unit = float(moved[moved > 0].min())
    slope = np.convolve(steps, np.array([1.0, 1.0, 0.0, 1.0, 1.0]) / 4.0, mode="same")
    # Of white noise of variance v the bend has 5 v, of which rounding is q²/12; a step has 2 v.
    bend = 1.4826 * float(np.median(np.abs(steps[1:-1] - 0.5 * (steps[:-2] + steps[2:]))))
    spread = np.sqrt(2.0 * max(bend**2 / 5.0 - unit**2 / 12.0, 0.0))
    out = np.zeros_like(steps)
    for node in NODES:
        out += np.clip(1.0 - np.abs(slope + spread * node) / unit, 0.0, 1.0) / NODES.size
    return out


def find_dropped_rows(recording: Recording) -> list[DroppedRows]:
    """Axes whose rows repeat more often than by chance."""
    out = []
    for axis in range(recording.axis_count):
        parts = [
            _repeats(e, axis)
            for e in recording.experiments
            if float(np.std(e.position[:, axis])) > 0 and float(np.std(e.torque[:, axis])) > 0
        ]
        if not parts:
            continue
        both, most, likely = (np.concatenate(p) for p in zip(*parts, strict=True))
        told = np.isfinite(most)
        repeated, rows = int(both[told].sum()), int(told.sum())
        if rows == 0 or repeated < 5:
            continue
        p0 = min(max(1.5 * float(most[told].sum()) / rows, 1e-9), 1.0)
        if binomial_sf(repeated - 1, rows, p0) > FALSE_ALARM / recording.axis_count:
            continue
        out.append(_share(axis, both[told], likely[told]))
    return out


def _share(axis: int, both: Bool, likely: Float64) -> DroppedRows:
    """The share that was lost, by the rows that hardly repeat by chance where there are enough of them."""

    def of(rows: Bool) -> tuple[float, float]:
        repeated, chance, count = float(both[rows].sum()), float(likely[rows].sum()), float(rows.sum())
        return (repeated - chance) / (count - chance), np.hypot(np.sqrt(repeated), NEARLY * chance) / count

    every = np.ones(both.size, dtype=bool)
    rare = likely < RARE * of(every)[0]
    options = [of(rows) for rows in (every, rare) if both[rows].sum() >= 5]
    share, std = min(options, key=lambda o: o[1])
    return DroppedRows(axis, float(share), float(std))


def interpolate_dropped_rows(recording: Recording, dropped: Sequence[DroppedRows]) -> Recording:
    """The recording with the repeated rows of those axes interpolated from their neighbours."""
    experiments = []
    for e in recording.experiments:
        position, torque = e.position.copy(), e.torque.copy()
        for d in dropped:
            both, _, _ = _repeats(e, d.axis)
            lost = np.concatenate(([False], both))
            kept = np.flatnonzero(~lost)
            if kept.size < 8:
                continue
            at = np.flatnonzero(lost)
            for channel in (position, torque):
                channel[at, d.axis] = _interpolated(e.time, channel[:, d.axis], kept, at)
        experiments.append(replace(e, position=position, torque=torque))
    return replace(recording, experiments=tuple(experiments))


def _interpolated(time: Float64, values: Float64, kept: np.ndarray, at: np.ndarray) -> Float64:
    out: Float64 = CubicSpline(time[kept], values[kept])(time[at])
    return out


def rms_before_repair(recording: Recording, base: JointFit) -> dict[str, float]:
    """Rms missing torque of every axis on the held-out records as they were recorded."""
    spectra = all_spectra(recording)
    _, held, _ = split_records(recording, spectra)
    evaluation = evaluate_held_out(base, held)
    return {axis: rms_torque(evaluation, i)[0] for i, axis in enumerate(recording.axes)}


def add_dropped_rows_finding(
    result: Diagnosis, recording: Recording, dropped: Sequence[DroppedRows], before: dict[str, float]
) -> Diagnosis:
    """The diagnosis of the repaired recording, with the dropped samples as a finding of their own."""
    if not dropped:
        return result
    residual = tuple(replace(r, before=max(before[r.axis], r.after)) for r in result.residual)
    explained = explained_share(residual)
    findings = []
    known = {e.axis for e in result.model.effects if e.cause == "dropped_samples"}
    for d in dropped:
        if recording.axes[d.axis] in known:
            continue
        own = next(r for r in residual if r.axis == recording.axes[d.axis])
        term = EffectTerm(
            "dropped_samples", own.axis, {"fraction": Estimate(d.fraction, d.std, unit_of("ratio", False))}
        )
        findings.append(
            Finding(
                effect=term,
                confidence=0.99,
                before=own.before,
                after=own.after,
                fraction=explained,
                sentence=(
                    f"Axis {own.axis}: {100 * d.fraction:.2g} % of the samples were lost and the one before "
                    f"was repeated. {BY_CAUSE['dropped_samples'].check}"
                ),
            )
        )
    if not findings:
        return replace(result, residual=residual, explained_fraction=explained)
    complete = result.verdict in (Verdict.CONSISTENT, Verdict.EXPLAINED)
    verdict = verdict_of(residual, explained, named=True, missing=True, complete=complete)
    left = result.unexplained
    if left is None and verdict is not Verdict.EXPLAINED:
        left = left_over(residual, explained)
    kept = [s for s in result.sentences if result.verdict is not Verdict.CONSISTENT]
    if left is not None and left is not result.unexplained:
        kept.append(left.sentence)
    return replace(
        result,
        verdict=verdict,
        unexplained=left,
        residual=residual,
        explained_fraction=explained,
        findings=(*findings, *result.findings),
        model=result.model.extended(*(f.effect for f in findings)),
        sentences=(*(f.sentence for f in findings), *kept),
    )
