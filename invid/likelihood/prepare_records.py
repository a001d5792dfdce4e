"""Spectra to the records of a diagnosis: 0 Hz included, noise filtered out of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import scipy

from invid.model.document import Model
from invid.numerics.arrays import Complex128, Float64
from invid.recording.model import Experiment, Recording
from invid.signals.drive_torque import covers_demand, mean_demand
from invid.signals.motor_motion import motor_motion
from invid.signals.periods import fold, remove_drift
from invid.signals.spectra import LineSpectra, spectra_of
from invid.signals.spectral_record import FINENESS, SpectralRecord
from invid.signals.standstill import standstill_velocity
from invid.signals.timebase import resample_uniformly

BAND_FACTOR = 1.2
"""Highest line used, over the highest excited one: distortion falls off above, noise does not."""
MOST_LINES = 3000
SAMPLES_PER_PERIOD = 16
"""Samples of a law of motion for each period of the highest line in use: what a law puts above an eighth of
its grid's rate does not alias onto the lines (jumps are averaged over their sample)."""


def spectral_record(
    s: LineSpectra,
    experiment: Experiment,
    rows: slice | None = None,
    *,
    alone: bool = False,
    demand: bool = False,
) -> SpectralRecord:
    """One record of a diagnosis; ``rows`` selects periods where there are several.

    ``alone``: a single period of a machine that changes; it has its own time and does not close. ``demand``:
    the torque is the logged demand and something beside it (``uses_demand``).
    """
    motors = s.axis_count
    count = s.position_wave.shape[0]
    share = 1.0
    theta, torque = s.position, s.torque
    if rows is not None:
        deviations = s.deviations[rows]
        share = s.periods / deviations.shape[0]
        both = deviations.mean(axis=0)
        theta, torque = theta + both[:, :motors], torque + both[:, motors:]
    excited = np.flatnonzero(s.excited)
    top = s.frequency_hz[excited[-1]] if excited.size else s.frequency_hz[-1]
    used = s.frequency_hz <= BAND_FACTOR * top * (1 + 1e-9)
    used &= np.arange(used.size) < MOST_LINES
    step = 1.0 / s.sample_rate_hz
    index = np.round(s.frequency_hz[used] * count * step).astype(int)
    wave, torque_wave = np.asarray(s.position_wave), np.asarray(s.torque_wave)
    if rows is not None:
        wave, torque_wave = _waves_of_periods(s, experiment, rows, alone)
    ramp = np.zeros(motors)
    if (s.transient and s.periods <= 1) or alone:
        ramp = (wave[-1] - wave[0]) / ((count - 1) * step)
    time = (np.arange(count) - (count - 1) / 2) * step
    closed = wave - time[:, None] * ramp
    spectrum = np.fft.rfft(closed, axis=0)
    noise_all = s.floor[:motors] * (count / 2.0) ** 2
    power = np.abs(spectrum) ** 2
    # Lines within six times the noise power are taken for noise (1 line in 400 of pure noise passes).
    keep = np.where(power > 6.0 * noise_all, 1.0 - noise_all / np.maximum(power, 1e-300), 0.0)
    keep[0] = 1.0
    clean = spectrum * keep
    grid = FINENESS * scipy.fft.next_fast_len(max(SAMPLES_PER_PERIOD * int(index[-1]), 256), real=True)
    moved = motor_motion(
        wave, step, s.floor[:motors], int(index[-1]), grid, closes=not (s.transient or alone)
    )
    filtered = clean[index] * (2.0 / count)
    floor = np.maximum(s.floor, 1e-300) * share
    # A torque without noise is a command: with none at all every error of the model would count as
    # position noise, without end. A ten-thousandth of its rms is below any drive's current noise; of a
    # sample's variance a line of n samples gets 4/n. A command gets that share of its lines' rms.
    power, is_pushed = np.abs(torque[used]) ** 2, np.asarray(s.excited)[used]
    is_command = floor[motors:] < 1e-8 * 2.0 * power.sum(axis=0) / (count * max(s.periods, 1))
    if is_pushed.any():
        least = 1e-8 * power[is_pushed].mean(axis=0)
        floor[motors:] = np.where(is_command, np.maximum(floor[motors:], least), floor[motors:])
    noise = np.tile(floor, (index.size + 1, 1))
    noise[1:] = np.maximum(noise[1:], s.line_floor[used] * share)
    # A mean's variance is a quarter of a line's power, and real: half of it as a complex line.
    noise[0] = floor / 2.0
    mean_torque = torque_wave.mean(axis=0)
    zero = np.zeros((1, motors), dtype=complex)
    start, end = _time_span(s, experiment)
    span, transient = s.span_s, s.transient
    if alone and rows is not None:
        span = s.span_s / s.periods
        start = start + rows.start * span
        end = start + span
        transient = True
    command = _command(s, experiment, index) if demand else None
    if command is not None:
        torque = torque - command[1]
    quiet = max((0.45 / step - 1.5 * top) * s.span_s / max(s.periods, 1), 1.0) * max(s.periods - 1, 1)
    fine = SpectralRecord(
        key=s.key,
        omega=np.concatenate(([0.0], s.omega[used])),
        lines=np.concatenate(([0], index)),
        position=np.concatenate((zero, theta[used])),
        torque=np.concatenate((mean_torque[None].astype(complex), torque[used])),
        filtered=np.concatenate((clean[:1] / count, filtered)),
        noise=noise,
        # The median of an exponential has 1/ln²2 times the variance of the mean.
        noise_dof=float(2.0 * quiet * np.log(2.0) ** 2),
        scatter=np.zeros((index.size + 1, motors)),
        span=span,
        transient=transient,
        step=step,
        motor_wave=moved.position,
        motor_velocity=moved.velocity,
        velocity_noise=moved.noise,
        torque_wave=torque_wave,
        wave_step=count * step / grid,
        ramp=ramp,
        staircase=np.asarray(s.staircase),
        start_time=start,
        end_time=end,
        period_time=s.span_s / max(s.periods, 1),
        excited=np.concatenate(([False], s.excited[used])),
        command=None if command is None else command[0],
        unseen=moved.unseen,
        ends_in=s.transient and s.periods <= 1 and rows is None,
        alone=alone and rows is not None,
        integrated=s.integrated,
    )
    return fine.on_coarse_grid()


def _waves_of_periods(
    s: LineSpectra, experiment: Experiment, rows: slice, alone: bool
) -> tuple[Float64, Float64]:
    """(n, M) mean position and torque over some of the periods that the spectra come from.

    A drift common to all has no place in a mean; a period ``alone`` keeps its position.
    """
    data, count = resample_uniformly(experiment), s.position_wave.shape[0]
    position = fold(data.position, count)[-s.periods :]
    position = position if alone else remove_drift(position)
    return position[rows].mean(axis=0), fold(data.torque, count)[-s.periods :][rows].mean(axis=0)


def _time_span(s: LineSpectra, experiment: Experiment) -> tuple[float, float]:
    """Start and end [s] of the part of the experiment that the spectra come from."""
    end = float(experiment.time[-1])
    return max(end - s.span_s, float(experiment.time[0])), end


def _command(s: LineSpectra, experiment: Experiment, index: np.ndarray) -> tuple[Complex128, Float64] | None:
    """Spectrum of the demand where it is not all of the torque, and what its ends add to the torque's.

    The spectrum of a record that does not close carries the trapezoid's correction of its ends, which a
    demand held over the sample does not need. A mean over periods that still settle needs none either: a held
    demand has no ends that could differ.
    """
    demand, count = experiment.torque_demand, s.position_wave.shape[0]
    if demand is None or not _has_whole_demand(s, experiment):
        return None
    wave, ends = mean_demand(s, demand)
    spectrum = np.fft.rfft(wave, axis=0)[index] * (2.0 / count)
    return np.concatenate((wave.mean(axis=0)[None].astype(complex), spectrum)), ends


def _has_whole_demand(s: LineSpectra, experiment: Experiment) -> bool:
    """Whether the demand is logged over all that the spectra come from, without resampling."""
    demand = experiment.torque_demand
    return demand is not None and demand.shape[0] == experiment.samples and covers_demand(s, demand)


def uses_demand(recording: Recording, spectra: Sequence[LineSpectra]) -> bool:
    """Whether the torque is taken as the logged demand and something beside it.

    It is where a record does not say for every axis that all torque is held over the sample, and in all
    records or in none: held torque acts half a sample later, and one time offset for both kinds left 2.3
    times the noise on a record without a cause.
    """
    experiments = {e.key: e for e in recording.experiments}
    return any(np.isnan(s.staircase).any() for s in spectra) and all(
        _has_whole_demand(s, experiments[s.key]) for s in spectra
    )


def split_into_periods(
    recording: Recording, records: Sequence[SpectralRecord], keys: Sequence[str]
) -> list[SpectralRecord]:
    """Records with those of the experiments ``keys`` split into their periods, each at its own time."""
    experiments = {e.key: e for e in recording.experiments}
    out: list[SpectralRecord] = []
    done: set[str] = set()
    for record in records:
        if record.key not in keys or record.weight.size:
            out.append(record)
            continue
        if record.key in done:
            continue
        done.add(record.key)
        s = spectra_of(experiments[record.key], drop_transient=False)
        if s.periods < 2 or s.deviations.shape[0] != s.periods:
            out.append(record)
            continue
        experiment = experiments[record.key]
        record_of = partial(spectral_record, alone=True, demand=record.command is not None)
        out += [_set_aside_as(record, record_of(s, experiment, slice(k, k + 1))) for k in range(s.periods)]
    return out


def _set_aside_as(whole: SpectralRecord, part: SpectralRecord) -> SpectralRecord:
    """A part of a record, its torque left out on the axes where that of the whole is."""
    if not whole.set_aside.any():
        return part
    noise, at = part.noise.copy(), whole.set_aside.size + np.flatnonzero(whole.set_aside)
    noise[:, at] = whole.noise[:, at].max(axis=0)
    return replace(part, noise=noise, set_aside=whole.set_aside)


LEAST_TORQUE = 3.0
"""Peak torque of a held axis over its Coulomb friction below which it counts as standing. Physical: a
sinusoid of three times the friction is below it for a fifth of each period, and then barely moves."""
MOST_STANDING = 0.1
"""Share of a record up to which a held axis may stand and still count as moved (empirical: whole cells)."""


def leave_out_sticking_axes(
    records: Sequence[SpectralRecord], spectra: Sequence[LineSpectra], model: Model, recording: Recording
) -> tuple[list[SpectralRecord], list[str]]:
    """Records without the torque of axes that stand on their own friction, and warnings.

    Static friction takes any value up to its limit, so no law of motion gives it. Held axes stand where the
    torque stays below it, driven ones where they hardly move for it.
    """
    friction = model.fit.get("friction", {})
    driven = {s.key: s.driven for s in spectra}
    out: list[SpectralRecord] = []
    axes: set[str] = set()
    driven_axes: set[str] = set()
    for record in records:
        aside = np.zeros(recording.axis_count, dtype=bool)
        noise = record.noise.copy()
        for i, axis in enumerate(recording.axes):
            entry = friction.get(f"{axis}.coulomb") if isinstance(friction, dict) else None
            if not isinstance(entry, dict):
                continue
            level, std = float(entry.get("value") or 0.0), float(entry.get("std") or np.inf)
            stands, names = (
                (_is_barely_moving, driven_axes) if driven[record.key][i] else (_is_below_friction, axes)
            )
            if level > 4.0 * std and stands(record, i, level):
                aside[i] = True
                names.add(axis)
                noise[:, recording.axis_count + i] += (1e3 * level) ** 2
        out.append(replace(record, noise=noise, set_aside=aside) if aside.any() else record)
    warnings = [
        f"axis {axis} stands on its friction while it is held: its torque there says nothing and is left "
        "out; excite all axes at once, or hold it with a slow creep"
        for axis in sorted(axes)
    ]
    warnings += [
        f"axis {axis} hardly moves for its friction in one experiment or more: its torque there says nothing "
        "and is left out; shake it harder"
        for axis in sorted(driven_axes)
    ]
    return out, warnings


def _is_below_friction(record: SpectralRecord, axis: int, level: float) -> bool:
    """Whether the torque of a held axis stays well below the ``level`` of its friction, and it stands.

    Where the chain behind it moves it all the same, its friction is that of its motion.
    """
    wave = record.torque_wave[:, axis]
    is_weak = bool(np.abs(wave - wave.mean()).max() < LEAST_TORQUE * level)
    return is_weak and _slow_share(record, axis) > MOST_STANDING


def _is_barely_moving(record: SpectralRecord, axis: int, _: float) -> bool:
    """Whether the sign of a motor's velocity, and so of its friction, is lost in noise for over half of a
    record."""
    return not record.standing[axis] and _slow_share(record, axis) > 0.5


def _slow_share(record: SpectralRecord, axis: int) -> float:
    """Share of a record in which a motor may stand."""
    v = record.motor_velocity[:, axis]
    return float(np.mean(np.abs(v) < standstill_velocity(v, float(record.velocity_noise[axis]))))


def line_weights(record: SpectralRecord, chosen: np.ndarray) -> SpectralRecord:
    """The record with weights that switch lines off; its waves keep all lines."""
    weight: Float64 = chosen.astype(float)
    return replace(record, weight=weight)
