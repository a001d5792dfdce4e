"""The phases of a sweep: one list that the engine runs and the forecast evaluates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invid.config import CellConfig
from invid.config.schema import LimitsConfig
from invid.numerics.arrays import Float64, frozen_float
from invid.planning.model import Doublet, PhasePlan, PlannedExperiment, Step, Trial
from invid.recording.model import Kind
from invid.signals import excitation
from invid.wording.sentence import sentence

SETTLE_S = 0.3
"""Held by the drives before anything else, to measure the torque that the holds need (gravity)."""
REST_S = 1.0
"""Longest pause between experiments in which the hold brings every axis back to its place."""
RESTED_S, SIGN_CAUGHT_S = 0.9, 0.5
"""What that pause, and the catch after the doublets, usually take where a model is known (case study)."""
FADE_S = 0.5
"""Least length of the raised-cosine start and end of an excitation."""
FIRST_S, CLIMB_S = 5.0, 10.0
"""Longest two steps of a trial: at a tenth of the amplitude, and at about a third. The first is never longer
than half of what is tried."""
RECORDED_CLIMB_S = 6.0
"""Length of a climb that is recorded: three cycles of the slowest line of the default plan."""
RAMP_S = 0.25
"""Raised-cosine start and end of an experiment that is recorded from rest: both are in the record."""
CLIMB_CYCLES = 3.0
"""And never below three cycles of the slowest line."""
FIRST_SHARE, CLIMB_SHARE = 0.25, 0.8
"""Largest shares of the two steps."""
SWEEP_S = 6.0
"""Length of the quick sweep on which single-axis experiments are tried."""
SIGN_FIRST_S, SIGN_LAST_S = 0.02, 1.28
"""Lengths of the doublets of the sign trial, doubled until the axis has moved enough."""
SIGN_COUNTS, SIGN_WINDOW = 50, 0.01
"""Enough is 50 encoder counts and 1 % of the window: the slope is then good to a few per cent."""
SIGN_MOST = 0.025
"""And never more of the window than that, whatever the encoder: the next doublet, twice as long, moves an
axis at most four times as far."""
SIGN_FAR = 4 * SIGN_MOST
SIGN_TRAVEL = 0.25
"""Announced for the doublets, as a share of the window: until the axis is caught, and when the motor that was
held lets go while masses swing behind it. Empirical: 0.21 at most (``tests/machines/test_announced.py``)."""
SIGN_QUIET_S, SIGN_CATCH_S = 0.07, 0.8
"""Stillness around each doublet, and the longest time in which the axis is caught after the last."""
SIGN_EDGE_S = 0.04
SLOW_WINDOW, SLOW_SHARE = 0.04, 0.2
"""The slow doublet that weighs an axis whose inertia is stated: aims at 4 % of the window with a fifth of the
trial's amplitude, which friction leaves more of than of less."""
SLOW_S = 0.5
"""Shortest doublet that weighs an axis: it moves as a whole (empirical, ``invid.sweep.inertia``)."""
SIGN_STEPS = 2
"""Doublets of the shortest length at smaller torques before the first: a scale may be ten times wrong."""
CATCH_HZ = 3.0
"""At rest an excited axis is brought back as if 3 Hz were the slowest line: a hold of 1 Hz, weaker where that
would ask for much torque. The hold of the shaking would let it drift for seconds."""
FREE_HZ = 0.1
"""As good as no hold within the three seconds of the doublets."""
SIGN_UNKNOWN_S = 1.5
"""Expected length of a sign trial on an axis whose inertia nobody has named: doublets up to 0.64 s."""
SPREAD_FIRST, SPREAD_EACH = 1.25, 0.95
"""Without a model: motion of all runs of a multisine over that of the ten seconds that the trial plays,
first + each·√(M − 1) with M axes shaken. The runs differ in the phases of the axes alone: what M axes do to
one adds up as a random walk. Empirical (``tests/machines/test_announced.py``)."""
SPREAD_USUAL = 0.5
"""Each, again, for most cells: torque is lowered for so much. What few cells do beyond it is announced, and
lies within the limit unless it is the same axis that is near one."""
SPREAD_CLIMB = 1.4
"""Usual motion of runs from rest, which begin where an axis drifts least, over that of a climb with
every line on all axes. Empirical (``benchmarks/planning/bench_spread.py``, 50 cells of one to four axes):
travel goes beyond it in 3, to 1.8 at most, velocity in 1; what is announced was exceeded in none."""
SPREAD_TORQUE = 1.25
"""The same for the torque, most of which is the excitation itself."""
SPREAD_SWEEP = (1.5, 2.0, 1.5)
"""Travel, velocity and torque of stepped sines and chirps over those of the quick sweep, which stays on a
resonance for a shorter time. Empirical (``tests/machines/test_announced.py``)."""


def fade_s(lowest_hz: float) -> float:
    """Length of the start of an excitation [s]: a cycle of its slowest line.

    A sine that starts at once on a free mass leaves it drifting at its peak velocity until the weak
    centring hold has caught it: twice the travel of the sine itself. A start over one cycle leaves a tenth.
    """
    return max(FADE_S, 1.0 / lowest_hz)


def lowest_frequency(experiments: Sequence[PlannedExperiment]) -> float:
    """The slowest line of experiments [Hz]."""
    return min(_lines_of(experiments), default=1.0)


def highest_frequency(experiments: Sequence[PlannedExperiment]) -> float:
    """The fastest line of experiments [Hz]; that of a slow move is none, 1 Hz stands for it."""
    return max(_lines_of(experiments), default=1.0)


def _lines_of(experiments: Sequence[PlannedExperiment]) -> list[float]:
    """All lines, and the ends of the bands that are swept [Hz]."""
    return [float(f) for e in experiments for f in (*e.frequencies_hz, *e.attributes.get("band_hz", ()))]


def sign_amplitude(
    config: CellConfig, experiments: Sequence[PlannedExperiment], axis: int
) -> tuple[float, float]:
    """Peak torque of the first doublets of an axis, and the most that they climb to where it does not move.

    A tenth of the plan's, and no less than a twentieth of the limit: a plan of little torque must not be
    tried with less than dry friction takes.
    """
    peak = max((float(np.abs(e.torque[:, axis]).max(initial=0.0)) for e in experiments), default=0.0)
    half = 0.5 * config.axes[axis].limits.torque
    first = config.safety.test_amplitude * max(peak, half)
    return first, max(first, peak if peak > 0 else half)


def sign_wanted(limits: LimitsConfig, resolution: float) -> float:
    """Motion [rad or m] at which the doublets of an axis may end."""
    return min(max(SIGN_WINDOW * limits.position, SIGN_COUNTS * resolution), SIGN_MOST * limits.position)


def sign_seconds(
    config: CellConfig, axis: int, amplitude: float, inertia: float | None, foretold: Doublet | None
) -> float:
    """Expected length of the sign trial of an axis [s]; a mass m moves by A·T²/(16·m) in a doublet."""
    first = (1 + SIGN_STEPS) * (SIGN_QUIET_S + SIGN_FIRST_S)
    if foretold is not None:
        return first + foretold.length_s + SIGN_QUIET_S + SIGN_CAUGHT_S
    if inertia is None:
        return SIGN_UNKNOWN_S
    settings = config.axes[axis]
    wanted = sign_wanted(settings.limits, settings.position_per_count or 0.0)
    length, seconds = SIGN_FIRST_S, first
    while amplitude * length**2 / (16 * inertia) < wanted and 2 * length <= SIGN_LAST_S:
        length *= 2
        seconds += length + SIGN_QUIET_S
    slow = np.sqrt(16 * inertia * SLOW_WINDOW * settings.limits.position / (SLOW_SHARE * amplitude))
    if slow > length:
        seconds += min(float(slow), SIGN_LAST_S) + SIGN_QUIET_S
    return seconds + SIGN_CATCH_S


def sign_doublet(config: CellConfig, axis: int, amplitude: float, inertia: float) -> PlannedExperiment:
    """Return the doublet that moves a rigid axis as far as one may, and its catch."""
    cycle = config.bus.cycle_s
    wave = amplitude * excitation.doublet(
        round(_rigid_doublet_length(config, axis, amplitude, inertia) / cycle)
    )
    return doublet_torque(
        config, axis, np.concatenate((wave, np.zeros(round(SIGN_CATCH_S / cycle)))), CATCH_HZ
    )


def sign_doublets(config: CellConfig, axis: int, amplitude: float, inertia: float) -> PlannedExperiment:
    """All doublets up to that one, before the catch: nothing holds the axis, and what swings goes on."""
    cycle = config.bus.cycle_s
    last, length = _rigid_doublet_length(config, axis, amplitude, inertia), SIGN_FIRST_S
    quiet = np.zeros(round(SIGN_QUIET_S / cycle))
    waves = [quiet]
    while length <= max(last, SIGN_FIRST_S):
        waves += [amplitude * excitation.doublet(round(length / cycle)), quiet]
        length *= 2
    return doublet_torque(config, axis, np.concatenate(waves), FREE_HZ)


def _rigid_doublet_length(config: CellConfig, axis: int, amplitude: float, inertia: float) -> float:
    far = SIGN_FAR * config.axes[axis].limits.position
    return float(min(max(np.sqrt(16 * inertia * far / amplitude), SIGN_FIRST_S), SIGN_LAST_S))


def doublet_torque(config: CellConfig, axis: int, wave: Float64, hold_hz: float) -> PlannedExperiment:
    """Return the torque (n,) of one axis as an experiment, its edges rounded."""
    torque = np.zeros((wave.size, len(config.axes)))
    # its edges rounded: what is worked out on lines up to 100 Hz may have nothing beyond them
    edge = np.hanning(max(round(SIGN_EDGE_S / config.bus.cycle_s), 1) + 2)
    torque[:, axis] = np.convolve(wave, edge / edge.sum())[: len(torque)]
    return PlannedExperiment(
        kind=Kind.OTHER,
        excited=(axis,),
        torque=frozen_float(torque),
        frequencies_hz=frozen_float([hold_hz]),
    )


def played_once(period: Float64, cycle_s: float, *, is_free: bool = True) -> Float64:
    """(n + 1, M) torque of one period (n, M) that is recorded whole, from rest to its fading out.

    ``is_free``: each axis may begin anywhere in its period, and does where it drifts least.
    """
    ramp = round(RAMP_S / cycle_s)
    if is_free:
        waves = [excitation.without_drift(w, 1.0 / cycle_s, ramp) if w.any() else w for w in period.T]
        period = np.stack(waves, axis=1)
    return excitation.apply_ramps(np.concatenate((period, period[:1])), ramp, ramp)


def trials_of(
    config: CellConfig, experiments: Sequence[PlannedExperiment], climb: PlannedExperiment | None = None
) -> tuple[Trial, ...]:
    """One trial for each kind of experiment on each set of axes, slow moves apart.

    A multisine is tried on the largest of its runs; the stepped sines and chirps of an axis on one quick
    sweep through their band. A slow move follows its path whatever the plant is: it needs none.
    Multisines are tried on ``climb`` where there is one, which is then recorded.
    """
    families: dict[tuple[bool, tuple[int, ...]], list[int]] = {}
    for number, e in enumerate(experiments):
        if e.kind is not Kind.CONSTANT_VELOCITY:
            families.setdefault((e.kind is Kind.MULTISINE, e.excited), []).append(number)
    found = []
    for (multisine, _), covers in families.items():
        covered = [experiments[k] for k in covers]
        peaks = [float(np.abs(e.torque).max(initial=0.0)) for e in covered]
        if max(peaks) <= 0:
            continue
        # the first of the largest; runs of one multisine differ by rounding
        largest = next(e for e, p in zip(covered, peaks, strict=True) if p >= 0.999 * max(peaks))
        share = 0.0
        if not multisine:
            largest = _quick_sweep(config, covered, largest, max(peaks))
        elif climb is not None:
            largest, share = climb, trial_shares(config, climb)[1]
        spreads = []
        others = np.sqrt(len(largest.excited) - 1)
        usual = SPREAD_CLIMB if share else SPREAD_FIRST + SPREAD_USUAL * others
        for further in (max(SPREAD_FIRST + SPREAD_EACH * others, usual), usual):
            more = (further, further, SPREAD_TORQUE) if multisine else SPREAD_SWEEP
            spreads.append(frozen_float(np.outer(more, np.ones(len(config.axes)))))
        found.append(Trial(largest, tuple(covers), spreads[0], spreads[1], share))
    return tuple(found)


def _quick_sweep(
    config: CellConfig, covered: Sequence[PlannedExperiment], largest: PlannedExperiment, peak: float
) -> PlannedExperiment:
    rate = 1.0 / config.bus.cycle_s
    low = lowest_frequency(covered)
    high = max(highest_frequency(covered), 1.2 * low)
    fade = round(fade_s(low) * rate)
    samples = round((SWEEP_S + fade_s(low)) * rate) + fade
    # the slow start stays at the lowest frequency, which moves an axis furthest
    first = fade + round(1.0 / low * rate)
    phase = np.cumsum(
        np.concatenate([np.full(first, low), np.linspace(low, high, max(samples - first, 1))])
    ) * (2 * np.pi / rate)
    torque = np.zeros((phase.size, len(config.axes)))
    torque[:, largest.excited[0]] = peak * excitation.apply_ramps(np.sin(phase), fade, round(FADE_S * rate))
    return PlannedExperiment(
        kind=Kind.CHIRP,
        excited=largest.excited,
        torque=frozen_float(torque),
        attributes={"band_hz": [low, high]},
    )


def trial_shares(config: CellConfig, experiment: PlannedExperiment) -> tuple[float, float]:
    """Shares of the amplitude of a trial's two steps: friction that hides motion in the first hides less
    in the second.

    As with the signs no axis is tried with less than a twentieth of its torque, or friction would hide all.
    """
    first = config.safety.test_amplitude
    for i in experiment.excited:
        peak = float(np.abs(experiment.torque[:, i]).max(initial=0.0))
        if peak > 0:
            first = max(first, 0.5 * config.safety.test_amplitude * config.axes[i].limits.torque / peak)
    first = min(first, FIRST_SHARE)
    return first, min(float(np.sqrt(first)), CLIMB_SHARE)


def excerpt(config: CellConfig, trial: Trial, step: int) -> PlannedExperiment:
    """What a trial plays in its step 0 or 1 at full amplitude, faded out at its end."""
    cycle, e = config.bus.cycle_s, trial.experiment
    seconds = max((FIRST_S, CLIMB_S)[step], CLIMB_CYCLES * step / lowest_frequency([e]))
    cycles = min((e.cycles // 2, e.cycles)[step], round(seconds / cycle))
    fade = min(round(FADE_S / cycle), cycles // 4)
    torque: Float64 = excitation.apply_ramps(e.torque[:cycles], 0, fade)
    reference = None if e.reference is None else frozen_float(e.reference[:cycles])
    return replace(e, torque=frozen_float(torque), reference=reference, record_from=0, record_to=cycles)


def phases_of(
    config: CellConfig,
    experiments: Sequence[PlannedExperiment],
    trials: Sequence[Trial],
    *,
    weights: Sequence[tuple[float | None, Doublet | None]],
) -> tuple[PhasePlan, ...]:
    """Return the phases from enabling to the end, in order, with their expected length in cycles.

    ``weights``: inertia of each axis and its doublet, where they are known.
    """
    cycle = config.bus.cycle_s
    known = all(doublet is not None for _, doublet in weights)
    rest = round((RESTED_S if known else REST_S) / cycle)
    found = [PhasePlan(Step.SETTLE, 0, "settling", round(SETTLE_S / cycle))]
    for i in sorted({i for e in experiments for i in e.excited}):
        seconds = sign_seconds(config, i, sign_amplitude(config, experiments, i)[0], *weights[i])
        name = sentence("trying the signs of {axis}", axis=config.axes[i].name)
        found.append(PhasePlan(Step.SIGNS, i, name, round(seconds / cycle)))
    led: tuple[int, ...] = ()
    resting: tuple[int, ...] | None = None

    def change(excited: tuple[int, ...]) -> int:
        """Return the cycles of rest before axes are shaken: those that were come to rest first."""
        nonlocal led
        before, led = led, excited
        if resting == excited:
            return 0
        return rest if before in ((), excited) or resting == before else 2 * rest

    for number, trial in enumerate(trials):
        cycles = change(trial.experiment.excited)
        steps = (1,) if trial.is_foretold else (0, 1)
        cycles += sum(excerpt(config, trial, step).cycles + rest for step in steps)
        found.append(PhasePlan(Step.TRIAL, number, "trying the amplitude", cycles))
        resting = trial.experiment.excited
    for number, e in enumerate(experiments):
        name = sentence("experiment {number} of {total}", number=number + 1, total=len(experiments))
        found.append(PhasePlan(Step.EXPERIMENT, number, name, e.cycles + change(e.excited)))
        resting = None
    found.append(PhasePlan(Step.RETURN, 0, "coming to rest", rest))
    return tuple(found)
