"""The loops as they are, measured while closed, beside what the tuning predicted: margins, ripple, a move.

Each axis is shaken by a torque added to that of its drive's own loops, at lines of its own. With d the torque
added and τ the torque measured, both over whole periods, S = τ/d is the sensitivity 1/(1 + L) of the loop
broken at that torque, the others closed: what ``margins`` predicts (Ljung 1999, 13.4; Åström and Hägglund
2006).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.stats import norm

from invid.errors import InputError
from invid.exchange.linear_plant import LinearPlant, linear_plant
from invid.model.document import Model
from invid.numerics.arrays import Complex128, Float64, Int64
from invid.recording import Experiment, Recording
from invid.tuning.axis_loop import AxisLoop
from invid.tuning.gains import own_inertias
from invid.tuning.margins import DrawnPlants, axis_margins, drawn_plants
from invid.tuning.measured_moves import asked_torque, lateness, shaken_motion
from invid.tuning.plant_draws import drawn_models
from invid.tuning.servo_loop import DriveTiming, Gains, held_plant_response
from invid.tuning.simulated_loops import Command, reference_move, run_loops, settling_times
from invid.tuning.tune import SPREAD_DRAWS, bearable, sensors_of, softened

DRAWS, SEED = 60, 0
RIPPLES = 8
"""Machines in which the ripple is worked out, up to half the rate of the loops: it hardly differs."""
TRIALS = 400
"""Draws of the measurement's noise from which the spread of margins is taken."""
FALSE_ALARMS = 0.01
"""Statistical: of an axis that is as predicted, shared among its lines."""
ALLOWED = 0.05
"""Physical: part of |S| that drives differ by from their law (current loop, rounding); less is not called
worse."""
FEW_DB = 0.25
"""Largest spread of max |S| that still says something about a peak (a convention)."""
NEIGHBOURS = 9
"""Lines, and silent lines between them, whose scatter is taken together: few periods alone say little."""
OTHER_BY, OTHER_SHARE = 0.15, 0.25
"""Empirical (benchmarks/drivers/bench_closed_loop.py): another machine than the model's, by part of S, at so
many of the lines where the loop does not hold the torque off."""
WORSE_MOVE = 2.0
"""Following error, over that of the worst machine drawn, from which the move is not that foretold. Empirical
(benchmarks/drivers/bench_closed_loop.py): right models within 1.4, with free play too; the one wrong 25."""
FAR = 0.5
"""|L| below which the phase of S shows how late the torque is read."""


class Verdict(StrEnum):
    """What the measurement says of the prediction."""

    AS_PREDICTED = "as_predicted"
    BETTER = "better"
    OTHER = "other"
    """Neither margin nor move is worse, but the machine is not the model's."""
    WORSE = "worse"
    CANNOT_TELL = "cannot_tell"

    @property
    def asks_for_undo(self) -> bool:
        """Whether the values stand on what was not found."""
        return self in (Verdict.WORSE, Verdict.OTHER)


@dataclass(frozen=True)
class Figure:
    """A number of a loop: as predicted, its range over machines drawn, as measured and its deviation."""

    predicted: float
    low: float
    high: float
    measured: float
    std: float


@dataclass(frozen=True, eq=False)
class AxisVerification:
    """One axis; ``measured``, ``std``, ``predicted`` and the range ``low``, ``high`` of |S| at ``frequency``
    (F,) [Hz]; ``late`` [s] is how late the torque is read, taken out of ``measured``; ``ripple`` the torque
    [N·m or N, rms] that the loop makes of its encoder's counts, ``rated`` NaN where it is not known.
    ``following`` [rad or m, rms] and ``settling`` [s, NaN: not in the rest] are the motor's in the reference
    move; ``wander`` [rad or m, rms] is motion that nothing asked for, beside that of counts."""

    axis: str
    frequency: Float64
    measured: Complex128
    std: Float64
    predicted: Complex128
    low: Float64
    high: Float64
    late: float
    sensitivity: Figure
    gain_margin: Figure
    phase_margin: Figure
    ripple: Figure
    following: Figure
    settling: Figure
    wander: Figure
    unit: str
    rated: float
    verdict: Verdict
    worst_at: float
    """Where it departs most from the prediction [Hz]."""


@dataclass(frozen=True, eq=False)
class Verification:
    """All axes that were shaken."""

    robot: str
    axes: tuple[AxisVerification, ...]

    @property
    def verdict(self) -> Verdict:
        """The worst of the axes."""
        found = {a.verdict for a in self.axes}
        order = (Verdict.WORSE, Verdict.OTHER, Verdict.CANNOT_TELL, Verdict.AS_PREDICTED, Verdict.BETTER)
        return next(v for v in order if v in found)


def verify(
    model: Model, loops: Mapping[str, AxisLoop], timing: DriveTiming, recording: Recording
) -> Verification:
    """What ``recording``, made while the loops were closed, shows of them, beside ``model``'s prediction.

    Raises
    ------
    InputError
        The recording has other axes, or nothing that was shaken in closed loop by whole periods.
    """
    if tuple(recording.axes) != tuple(model.axes):
        raise InputError(f"the recording has the axes {list(recording.axes)}, the tuning {list(model.axes)}")
    missing = [a for a in model.axes if a not in loops]
    if missing:
        raise InputError(f"the tuning has no values of axis {missing[0]}")
    rng = np.random.default_rng(SEED)
    drawn, loose = drawn_models((model,), DRAWS, rng), softened(model)
    plants = tuple(linear_plant(m) for m in (model, *drawn, *([] if loose is None else [loose])))
    counts, command = (
        sensors_of(model).counts,
        reference_move(plants[0], timing, bearable(model, own_inertias(plants[0]))),
    )
    own = [loops[a] for a in model.axes]
    moved = [
        run_loops(m, own, command, timing, counts)
        for m in (model, *drawn_models((model,), SPREAD_DRAWS, rng))
    ]
    cell = _Cell(model, plants, own, timing, command, [r.command - r.motor for r in moved])
    found = [
        cell.axis(axis, shaken, rng)
        for axis in range(len(model.axes))
        if (shaken := _shaken(recording, axis)) is not None
    ]
    if not found:
        raise InputError(
            f"{recording.source or 'the recording'}: nothing in it was shaken in closed loop by whole "
            "periods",
            way_out="measure with `invid verify`, or a multisine of some periods with in_closed_loop: true",
        )
    return Verification(model.robot, tuple(found))


@dataclass(frozen=True, eq=False)
class _Shaken:
    """Spectra of one axis at its ``lines`` over P periods: torque added and torque (P, F), what of torque and
    position does not repeat, over all frequencies (P, F'), and the mean torque there (F') with the indices at
    which nothing was shaken: what is there is noise or distortion. ``period`` (N, M) is the torque added."""

    axis: str
    frequency: Float64
    lines: Int64
    period: Float64
    added: Complex128
    torque: Complex128
    position: Complex128
    left: tuple[Complex128, Complex128]
    whole: Complex128
    silent: Int64
    cycle: float


def _shaken(recording: Recording, axis: int) -> _Shaken | None:
    for e in recording.experiments:
        lines = _own_lines(e, axis)
        if lines.size:
            n = e.period_samples
            periods = e.position.shape[0] // n

            def spectra(x: Float64, n: int = n, periods: int = periods) -> Complex128:
                return np.fft.rfft(x[: periods * n, axis].reshape(periods, n), axis=1) / n

            added, torque, position = (
                spectra(np.asarray(x)) for x in (e.torque_demand, e.torque, e.position)
            )
            mean = torque.mean(axis=0)
            shaken = np.round(np.asarray(e.frequencies_hz) * n / e.sample_rate_hz).astype(int)
            silent = np.setdiff1d(np.arange(lines.min() + 1, lines.max()), shaken)
            return _Shaken(
                recording.axes[axis], lines * e.sample_rate_hz / n, lines, np.asarray(e.torque_demand)[:n],
                added[:, lines], torque[:, lines], position[:, lines],
                (torque - mean, position - position.mean(axis=0)), mean, silent, 1.0 / e.sample_rate_hz,
            )  # fmt: skip
    return None


def _own_lines(e: Experiment, axis: int) -> Int64:
    """Indices of the lines at which this axis alone was shaken, in whole periods and in closed loop."""
    none = np.zeros(0, dtype=int)
    if e.torque_demand is None or e.period_samples <= 0 or not np.isnan(np.asarray(e.hold_gain)).all():
        return none
    if e.position.shape[0] < 2 * e.period_samples:
        return none
    lines = np.round(np.asarray(e.frequencies_hz) * e.period_samples / e.sample_rate_hz).astype(int)
    power = np.abs(np.fft.rfft(np.asarray(e.torque_demand)[: e.period_samples], axis=0)[lines])
    own = power[:, axis]
    others = np.delete(power, axis, axis=1).max(axis=1, initial=0.0)
    return lines[(own > 0.05 * own.max(initial=0.0)) & (own > 20.0 * others)] if own.any() else none


@dataclass(frozen=True, eq=False)
class _Cell:
    """Machines drawn under their loops, the model's own first, and what their motors miss of the reference
    move (n, M)."""

    model: Model
    plants: tuple[LinearPlant, ...]
    loops: Sequence[AxisLoop]
    timing: DriveTiming
    command: Command
    foretold: Sequence[Float64]

    @property
    def gains(self) -> list[Gains]:
        return [loop.gains for loop in self.loops]

    def axis(self, index: int, seen: _Shaken, rng: np.random.Generator) -> AxisVerification:
        """One axis as measured, beside what the machines drawn show."""
        omega, sensors = 2 * math.pi * seen.frequency, sensors_of(self.model)
        predicted = self._drawn(omega)[0][:, :, index]
        mean, std = (seen.torque / seen.added).mean(axis=0), _deviation(seen)
        late = _late(mean, predicted[0], omega, seen.cycle)
        measured = mean * np.exp(1j * omega * late)
        tried = measured + _noise(std, rng)
        shown, spread = _figures(measured[None])[:, 0], _figures(tried).std(axis=1)
        figures = [_figure(f, m, s) for f, m, s in zip(_figures(predicted), shown, spread, strict=True)]
        size, low, high = np.abs(measured), np.abs(predicted).min(axis=0), np.abs(predicted).max(axis=0)
        beyond = (size - (1.0 + ALLOWED) * np.maximum(high, 1.0)) / std
        astray = np.abs(measured - predicted[0]) > 3.0 * std + OTHER_BY * np.abs(predicted[0])
        is_other = bool(astray[np.abs(predicted[0]) > FAR].mean() > OTHER_SHARE)
        quiet = drawn_plants(self.plants[:RIPPLES], self.timing).ripple(self.gains, sensors.counts)
        following, settling = self._move(index, seen, rng)
        count = float(np.nan_to_num(sensors.counts[index])) / math.sqrt(12.0)
        wander = _figure(np.array([count]), _unrepeated(seen.left[1]), math.nan)
        moves_worse = (
            following.measured - 3.0 * following.std > WORSE_MOVE * following.high
            or wander.measured > following.high + 2.0 * count
        )
        verdict = Verdict.WORSE if moves_worse else _judge(beyond, figures[0], is_other=is_other)
        return AxisVerification(
            seen.axis, seen.frequency, measured, std, predicted[0], low, high, late,
            figures[0], figures[1], figures[2],
            _figure(quiet[:, index], _ripple(seen), math.nan), following, settling, wander,
            "m" if self.model.linear else "rad", float(sensors.rated[index]), verdict,
            float(seen.frequency[int(np.argmax(np.abs(np.log(size / np.clip(size, low, high)))))]),
        )  # fmt: skip

    def _drawn(self, omega: Float64, count: int | None = None) -> tuple[Complex128, DrawnPlants]:
        """S (D, F, M) of the first ``count`` machines, and the machines."""
        plants = self.plants[:count]
        response = np.stack([held_plant_response(p, self.timing, omega) for p in plants])
        drawn = DrawnPlants(tuple(plants), self.timing, np.tile(omega, (len(plants), 1)), response)
        return 1.0 / (1.0 + drawn.loops(self.gains)), drawn

    def _move(self, index: int, seen: _Shaken, rng: np.random.Generator) -> tuple[Figure, Figure]:
        """Following error and settling of the motor as the loops measured make the reference move."""
        omega, n, cycle = 2 * math.pi * seen.frequency, len(seen.period), self.timing.cycle
        motion = shaken_motion(
            self.model, self.loops, self.timing, sensors_of(self.model).counts, seen.period
        )
        told = (np.fft.rfft(motion[:, index]) / n)[seen.lines] / seen.added.mean(axis=0)
        each = seen.position / seen.added / told
        std = np.maximum(np.sqrt(each.var(axis=0, ddof=1) / len(each)), 1e-9)
        mean = each.mean(axis=0)
        ratio = mean * np.exp(1j * omega * lateness(mean / np.abs(mean), 1.0 / std, omega, cycle))
        asked = asked_torque(self.command, index, self.loops[index], self.timing, float(omega.max()))
        sensitivity, drawn = self._drawn(asked.omega, 1)
        compliance = sensitivity[0, :, index] * drawn.behind_axis(index, self.gains)[0]

        def moved(error: Float64) -> Float64:
            """(2, D) rms and settling time of command less motor (D, n)."""
            settling = settling_times(error, self.command, index, cycle)
            return np.stack([np.sqrt((error**2).mean(axis=1)), settling])

        def figures(found: Complex128, missed: Float64) -> Float64:
            between = [np.interp(asked.omega, omega, r.real) + 1j * np.interp(asked.omega, omega, r.imag)
                       for r in found]  # fmt: skip
            return moved(missed + asked.missed(compliance * (1.0 - np.array(between))))

        foretold = np.stack([missed[:, index] for missed in self.foretold])
        shown = figures(ratio[None], foretold[:1])
        spread = figures(ratio + _noise(std, rng), foretold[:1]).std(axis=1)
        rows = zip(moved(foretold), shown[:, 0], spread, strict=True)
        following, settling = (_figure(f, m, s) for f, m, s in rows)
        return following, settling


def _noise(std: Float64, rng: np.random.Generator) -> Complex128:
    """(TRIALS, F) draws of complex noise of deviation ``std`` (F,)."""
    drawn = rng.standard_normal((2, TRIALS, std.size)) * std / math.sqrt(2.0)
    return np.asarray(drawn[0] + 1j * drawn[1], dtype=complex)


def _figure(foretold: Float64, measured: float, std: float) -> Figure:
    """Of values foretold (D,), the model's own first."""
    return Figure(
        float(foretold[0]), float(foretold.min()), float(foretold.max()), float(measured), float(std)
    )


def _unrepeated(left: Complex128) -> float:
    """Rms of what is not the same in every period (P, F')."""
    power = 2.0 * np.abs(left) ** 2
    power[:, 0] /= 2.0
    return float(np.sqrt(power.sum() / (len(left) - 1)))


def _figures(sensitivity: Complex128) -> Float64:
    """(3, D) max |S|, gain margin and phase margin [°] of S (D, F)."""
    gain, phase, _ = axis_margins(1.0 / sensitivity - 1.0)
    return np.stack([np.abs(sensitivity).max(axis=1), np.minimum(gain, 1e3), phase])


def _deviation(seen: _Shaken) -> Float64:
    """(F,) standard deviation of the mean of S: scatter over periods, and distortion as the silent lines
    around show it (Pintelon and Schoukens 2012, 4.3), each with its neighbours."""
    each = seen.torque / seen.added
    variance = _around(each.var(axis=0, ddof=1) / each.shape[0])
    if seen.silent.size < NEIGHBOURS:
        return np.asarray(np.sqrt(variance), dtype=float)
    stray = _around(np.abs(seen.whole[seen.silent]) ** 2)
    at = np.interp(seen.lines, seen.silent, stray) / np.abs(seen.added.mean(axis=0)) ** 2
    return np.asarray(np.sqrt(np.maximum(variance, at)), dtype=float)


def _around(variance: Float64) -> Float64:
    """(F,) mean over ``NEIGHBOURS``."""
    width = min(NEIGHBOURS, variance.size)
    padded = np.pad(variance, (width // 2, width - 1 - width // 2), mode="edge")
    mean = np.convolve(padded, np.full(width, 1.0 / width), mode="valid")
    return np.asarray(np.maximum(mean, 1e-16), dtype=float)


def _late(measured: Complex128, predicted: Complex128, omega: Float64, cycle: float) -> float:
    """How much later the torque is read than it was asked for [s].

    From the phase at lines where little is fed back, so that an error of the model hardly counts; all lines
    of the upper half where there are none.
    """
    far = (np.abs(1.0 / predicted - 1.0) < FAR) & (omega > np.median(omega))
    if far.sum() < NEIGHBOURS:
        far = omega > np.median(omega)
    return lateness((measured / predicted)[far], np.ones(int(far.sum())), omega[far], cycle)


def _ripple(seen: _Shaken) -> float:
    """Rms of the torque that is the loop's answer to what its encoder shows and that does not repeat.

    The part of torque that is coherent with position in bands of neighbouring lines, less what chance alone
    makes (Bendat and Piersol 2010): noise of the torque reading does not count.
    """
    torque, position = seen.left
    width = max(8, torque.shape[1] // 64)
    edges = np.arange(1, torque.shape[1], width)
    cross = np.add.reduceat((torque * position.conj()).sum(axis=0), edges)
    own, other = (np.add.reduceat((np.abs(x) ** 2).sum(axis=0), edges) for x in (position, torque))
    count = np.diff([*edges, torque.shape[1]]) * (torque.shape[0] - 1)
    share = np.abs(cross) ** 2 / np.maximum(own * other, 1e-300)
    coherent = np.clip((share - 1.0 / count) / (1.0 - 1.0 / count), 0.0, None) * other
    return float(np.sqrt(2.0 * coherent.sum() / (torque.shape[0] - 1)))


def _judge(beyond: Float64, peak: Figure, *, is_other: bool) -> Verdict:
    """``beyond`` (F,): by how many deviations |S| passes what was predicted and what is allowed."""
    if beyond.max() > norm.isf(FALSE_ALARMS / beyond.size):
        return Verdict.WORSE
    if peak.std > FEW_DB:
        return Verdict.CANNOT_TELL
    if is_other:
        return Verdict.OTHER
    return (
        Verdict.BETTER
        if peak.measured + 3.0 * peak.std < (1.0 - ALLOWED) * peak.low
        else Verdict.AS_PREDICTED
    )
