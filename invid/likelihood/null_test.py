"""Null test: the missing torque against the noise, with the scatter between periods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.effects.motion import View
from invid.likelihood.evaluation import Evaluation, record_views, residual_covariance
from invid.likelihood.hypothesis import Layout
from invid.likelihood.nuisance.transients import project_out_ends
from invid.numerics.arrays import Bool, Complex128, Float64
from invid.numerics.distributions import f_sf
from invid.signals.spectra import LineSpectra
from invid.signals.spectral_record import SpectralRecord

FALSE_ALARM = 0.01
"""Share of recordings without a cause that the test may reject (statistical)."""
LEAST_SCATTER, LEAST_WANDER = 9.0, 0.1
"""Power of the scatter between periods over the sensors', and rms of the motion's differences over the
motion, from which the scatter may be the machine's own. A machine that is not linear and does not settle (a
ripple, a gap, an axis held softly) moves differently in each period, by laws that hold in all. Empirical: six
such machines differed by 13 to 120 %, one shaken by random torque of a tenth by 3 %."""
POOLED_LINES = 40
"""Lines over which the scatter between periods is pooled (statistical: 80 real degrees of freedom a
period)."""


@dataclass(frozen=True)
class NullTest:
    """χ² of the missing torque against the noise; F distributed, because the noise itself is estimated."""

    chi2: float
    dof: int
    noise_dof: float
    p: float

    @property
    def rejects(self) -> bool:
        """Whether noise alone would give this less often than the false-alarm rate."""
        return self.p < FALSE_ALARM


FEW_PERIODS = 3
"""Number of periods too small for Von Neumann's ratio: a step within the middle one looks like scatter."""


def null_test(cost: float, dof: int, records: Sequence[SpectralRecord]) -> NullTest:
    """The null test of a χ² ``cost`` with ``dof``: χ²/ν is F(ν, ν_noise), the noise from few numbers of quiet
    lines."""
    noise_dof = float(sum(r.noise_dof for r in records))
    p = f_sf(cost / max(dof, 1), max(dof, 1), max(noise_dof, 2.0))
    return NullTest(cost, dof, noise_dof, p)


def add_scatter(
    records: Sequence[SpectralRecord], spectra: Sequence[LineSpectra], layout: Layout, p: Float64
) -> list[SpectralRecord]:
    """Records with the scatter between periods in their noise, where it exceeds the sensors' floor.

    The scatter of Z Θ − T over periods, in units of the floor's prediction; pooled over neighbouring lines
    and taken only where it is three standard errors above one: coloured noise, a process that does not
    repeat. Motion that does not repeat cancels in Z Θ − T and raises nothing.
    """
    known = {s.key: s for s in spectra}
    out: list[SpectralRecord] = []
    scattering: list[tuple[int, int, bool]] = []
    for record in records:
        s = known[record.key]
        periods = s.deviations.shape[0]
        if periods < 2 or record.alone:
            out.append(record)
            continue
        motors, lines = record.torque.shape[1], record.omega.size - 1
        plain = record_views(layout, [replace(record, scatter=np.zeros_like(record.scatter))], p)[0]
        e, covariance, used = period_deviations(plain, s)
        expected = np.einsum("fii->fi", covariance).real
        single = expected * used
        left = 1.0
        # A transient has a trend over the periods; scatter without one is noise.
        if record.transient and (periods <= 3 or _has_trend(e, single)):
            e, left = project_out_ends(plain, layout, p, e, covariance)
        ratio = (np.abs(e) ** 2).sum(axis=0) / (periods - 1) / single / left
        trend = _has_trend(e, single)
        differs = float(ratio.mean()) > LEAST_SCATTER and _wander_share(record, s) > LEAST_WANDER
        scattering.append((len(out), periods, _has_scatter(e, single)))
        scatter = np.ones_like(record.scatter)
        window = min(POOLED_LINES, lines)
        kernel = np.ones(window) / window
        error = 1.0 / np.sqrt(window * (periods - 1))
        for i in range(motors):
            total = np.convolve(np.pad(ratio[:, i], window, mode="reflect"), kernel, mode="same")[
                window:-window
            ]
            overall = float(ratio[:, i].mean())
            spread = 1.0 / np.sqrt(lines * (periods - 1))
            level = overall if overall > 1.0 + 3.0 * spread else 1.0
            scatter[1:, i] = np.where(total > level + 3.0 * error * level, total, level)
        added = np.zeros_like(record.scatter)
        added[1:] = (scatter[1:] - 1.0) * expected
        # The mean's slow wander is that of the first lines; half of it as a complex line.
        floor = 0.5 * record.noise[1, motors:]
        added[0] = np.maximum((_scatter_of_mean(ratio) - 1.0) * floor, 0.5 * added[1])
        # The part of the noise that scatters is known from the periods alone: χ² is F with both numbers.
        part = float(np.mean(1.0 - 1.0 / scatter))
        told = 2.0 * (periods - 1) * lines * left
        dof = 1.0 / ((1.0 - part) ** 2 / max(record.noise_dof, 1.0) + part**2 / told)
        dof = min(dof, record.noise_dof)
        out.append(replace(record, scatter=added, trend=trend, differs=differs, noise_dof=dof))
    # Two or three periods are too few to see a trend. A noise process scatters in every record; scatter in
    # only some of them is a change that happened once.
    if not all(scatters for *_, scatters in scattering):
        for number, periods, scatters in scattering:
            if scatters and periods <= FEW_PERIODS:
                out[number] = replace(out[number], trend=True)
    return out


def period_deviations(view: View, s: LineSpectra) -> tuple[Complex128, Complex128, int]:
    """(P, F, M) deviations of Z Θ − A T of each period from their mean, on lines 1…F.

    Also the covariance (F, M, M) of that mean by the sensors' noise, and the number of periods that it is the
    mean of.
    """
    record, motors = view.record, view.record.torque.shape[1]
    has_torque = np.abs(record.torque) > 0
    factor = np.where(has_torque, view.acting / np.where(has_torque, record.torque, 1.0), 1.0)
    own = s.deviations[:, : record.omega.size - 1]
    e = np.einsum("fij,pfj->pfi", view.stiffness[1:], own[..., :motors]) - factor[1:] * own[..., motors:]
    # ``noise`` is of the mean over the periods used in this record.
    share = 2.0 * float(record.noise[0, 0] / max(s.floor[0], 1e-300))
    return e, residual_covariance(view, factor)[1:], max(round(s.deviations.shape[0] / share), 1)


def _wander_share(record: SpectralRecord, s: LineSpectra) -> float:
    """Difference of a single period's motion from the mean over that mean, for the driven axis where it is
    largest.

    Axes that are held hardly move.
    """
    lines, motors = record.omega.size - 1, record.position.shape[1]
    deviation = (np.abs(s.deviations[:, :lines, :motors]) ** 2).sum(axis=(0, 1)) / s.deviations.shape[0]
    motion = (np.abs(record.position[1:]) ** 2).sum(axis=0)
    share = deviation / np.maximum(motion, 1e-300)
    return float(np.sqrt(np.max(share[s.driven] if s.driven.size else share, initial=0.0)))


def _has_trend(e: Complex128, single: Float64) -> bool:
    """Whether the (P, F, M) scatter has a trend or a step over time.

    Von Neumann's ratio of successive differences to the variance is 1 for scatter without memory and
    P-dependent but below a half for a drift or a step between periods. A step within a period makes that one
    unlike both sides; without it the variance about the means of the two sides is that of the noise.
    """
    periods = e.shape[0]
    if periods < 3 or not _has_scatter(e, single):
        return False
    white = e / np.sqrt(single)
    variance = float((np.abs(white) ** 2).sum() / (periods - 1))
    successive = float((np.abs(np.diff(white, axis=0)) ** 2).sum() / (2 * (periods - 1)))
    # One period before would be any that has not settled.
    return successive < 0.65 * variance or any(_has_step(white, k, variance) for k in range(2, periods - 1))


def _has_step(white: Complex128, within: int, variance: float) -> bool:
    """Whether the (P, F, M) periods on either side of one scatter much less than all of them do.

    By four standard deviations and to less than two thirds (statistical).
    """
    dof = white.shape[0] - 3
    if dof < 1:
        return False
    sides = (white[:within], white[within + 1 :])
    left = sum(float((np.abs(side - side.mean(axis=0)) ** 2).sum()) for side in sides)
    power = (np.abs(white - white.mean(axis=0)) ** 2).sum(axis=0)
    lines = float(power.sum() ** 2 / (power**2).sum())  # as many as the scatter really has
    return bool(left / dof < min(0.65, 1.0 - 4.0 / np.sqrt(dof * lines)) * variance)


def _has_scatter(e: Complex128, single: Float64) -> bool:
    """Whether the (P, F, M) scatter exceeds the sensors' by six standard deviations of χ²/ν (statistical)."""
    periods, lines = e.shape[0], e[0].size
    level = float((np.abs(e) ** 2 / single).sum() / (periods - 1)) / lines
    return bool(level > 1.0 + 6.0 / np.sqrt(lines * (periods - 1)))


def _scatter_of_mean(ratio: Float64) -> Float64:
    """(M,) scatter of the mean torque beside white noise, taken from the (F, M) scatter of the first
    lines."""
    out: Float64 = np.maximum(ratio[:3].mean(axis=0), 1.0)
    return out


def informative_lines(covariance: Complex128, record: SpectralRecord) -> Bool:
    """(F, M) lines with information: not those where a clamped resonance multiplies position noise."""
    level = np.einsum("fii->fi", covariance).real
    good: Bool = level <= 10.0 * np.median(level, axis=0)
    good[0] = True
    if record.weight.size:
        good &= record.weight[:, None] > 0
    return good


def rms_torque(evaluation: Evaluation, axis: int, bands: Sequence[Bool] | None = None) -> tuple[float, float]:
    """Rms over time of an axis' missing torque and of its noise floor, mean over the records."""
    powers, floors = [], []
    aside = [bool(v.record.set_aside.size and v.record.set_aside[axis]) for v in evaluation.views]
    for number, view in enumerate(evaluation.views):
        if aside[number] and not all(aside):
            continue
        r = evaluation.missing[number][:, axis]
        c = np.einsum("fii->fi", evaluation.covariance[number]).real[:, axis]
        good = (
            informative_lines(evaluation.covariance[number], view.record) if bands is None else bands[number]
        )[:, axis]
        weight = np.full(r.size, 0.5)
        weight[0] = 1.0
        powers.append(float((np.abs(r) ** 2 * weight)[good].sum()))
        c = c.copy()
        c[0] *= 0.5  # real
        floors.append(float((c * weight)[good].sum()))
    return float(np.sqrt(np.mean(powers))), float(np.sqrt(np.mean(floors)))


def scatter_share(evaluation: Evaluation, axis: int) -> float:
    """Share of the power of an axis' noise floor that is scatter between periods, not the sensors' noise."""
    floor = rms_torque(evaluation, axis)[1]
    powers = []
    for covariance, view in zip(evaluation.covariance, evaluation.views, strict=True):
        good = informative_lines(covariance, view.record)[1:, axis]
        powers.append(0.5 * float(view.record.scatter[1:, axis][good].sum()))
    return float(np.mean(powers)) / floor**2 if floor > 0 else 0.0


__all__ = ["NullTest", "add_scatter", "informative_lines", "null_test", "rms_torque", "scatter_share"]
