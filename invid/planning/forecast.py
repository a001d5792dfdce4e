"""Bounds of a run's motion and torque, from the last model or, for an unknown plant, from the limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.config import CellConfig
from invid.numerics.arrays import Float64, frozen_float
from invid.planning.belief import Belief
from invid.planning.model import AxisForecast, Doublet, Plan, PlannedExperiment, Trial
from invid.planning.phases import (
    FREE_HZ,
    REST_S,
    SIGN_COUNTS,
    SIGN_LAST_S,
    SIGN_MOST,
    SIGN_TRAVEL,
    SLOW_S,
    doublet_torque,
    excerpt,
    sign_amplitude,
    sign_doublet,
    sign_doublets,
    trial_shares,
)
from invid.planning.response import Motion, foretold_motion, held_by_drive, hold_gains
from invid.signals import excitation
from invid.wording.sentence import sentence

MARGIN = 1.25
"""Announced motion and torque over those that the model predicts. Empirical: models from an identification
predict the peaks of the same machine to a tenth, with 5 % of friction (``tests/machines/test_announced.py``);
what exceeds the margin the trial sees, and scales down."""
DRIVE_HOLDS_HZ = (5.0, 15.0, 50.0)
"""Assumed bandwidths [Hz] of the unknown loops inside the drives, on the rigid axis; the worst counts."""
READING_NOISE = 0.03
"""Noise of 0x6077 as a share of rated torque: six standard deviations of 0.5 %, as the watch allows."""
USABLE_SHARE = 0.95
"""Share of a limit that what is announced may use."""
MOST_GROWTH = 1.6
"""A straight line through zero at a tenth of the amplitude and the motion at a third rises so much; one that
begins later has stuck there, and nothing more can be said."""
LARGEST_SPREAD = 10.0
"""Largest spread with which a trial says anything about the experiments: its axis hardly moved beyond
that."""
ENOUGH, DOUBLETS = 2.0, 12
"""A doublet is laid out for so many times the counts that a trial needs, as friction and a changed load leave
less; lengths that are tried for it."""
DOUBLETS_MOTION = 3.0
"""Motion in the doublets over that of one from rest: each begins where the one before left the axis moving.
Empirical (``tests/machines/test_announced.py``)."""
DOUBLETS_TORQUE = 5.0
"""Torque after the doublets over that of one: a drive whose own hold takes an axis over stops it, with what
swings behind it. Empirical: 4.2 at most (``tests/machines/test_announced.py``)."""
ROUNDS = 6
CREEP_RATIO = 2.5
"""Creep in rms velocities of the shaking above which a motor hardly turns back (once in a hundred, normal).
Empirical, peak twice the friction: there every seed was good to 1 %; with three fifths of it two were, with
three tenths none."""


@dataclass(frozen=True, eq=False)
class Peaks:
    """What an experiment at most does to every axis.

    Attributes
    ----------
    motion
        (3, M) largest travel, velocity and torque, with the margin of a model on all but the planned
        excitation itself; in proportion to the amplitude.
    friction
        (3, M) what dry friction adds whatever the amplitude is: how far from its place it lets an axis rest,
        and the torque that it takes of an axis that is led.
    """

    motion: Float64
    friction: Float64

    @property
    def bound(self) -> Float64:
        """Return the (3, M) larger of motion and torque of both."""
        return self.motion + self.friction


def highest(parts: Sequence[Float64], axes: int) -> Float64:
    """Return the (3, M) largest of several peaks."""
    result: Float64 = np.max([np.zeros((3, axes)), *parts], axis=0)
    return result


def peaks_of(config: CellConfig, experiment: PlannedExperiment, belief: Belief) -> Peaks:
    """Largest motion and torque of start, run-in, record, end and the rest after it, from rest.

    Friction, which only reduces the motion, is left out.
    """
    count = len(config.axes)
    free = replace(belief, coulomb=np.zeros(count))
    rest = round(REST_S / config.bus.cycle_s)
    whole = _append_rest(experiment, rest)
    bandwidths = DRIVE_HOLDS_HZ if held_by_drive(config, experiment).any() else DRIVE_HOLDS_HZ[:1]
    found = []
    for bandwidth in bandwidths:
        motion = foretold_motion(config, whole, free, drive_hold_hz=bandwidth)
        found.append(with_margin(motion, whole.torque))
    stiffness, _ = hold_gains(config, experiment, belief)
    led = np.array([i in experiment.excited for i in range(count)])
    friction = led * np.stack([belief.coulomb / stiffness, np.zeros(count), belief.coulomb])
    return Peaks(highest(found, count), friction)


def with_margin(motion: Motion, excitation: Float64) -> Float64:
    """(3, M) largest travel, velocity and torque with the margin of a model; ``excitation`` is known."""
    held = excitation + MARGIN * (motion.torque - excitation)
    result: Float64 = np.abs([MARGIN * motion.position, MARGIN * motion.velocity, held]).max(axis=1)
    return result


def _append_rest(e: PlannedExperiment, rest: int) -> PlannedExperiment:
    torque = np.concatenate((e.torque, np.zeros((rest, e.torque.shape[1]))))
    path = e.reference
    if path is not None:
        path = np.concatenate((path, np.repeat(path[-1:], rest, axis=0)))
    return replace(e, torque=torque, reference=path)


def model_trials(
    config: CellConfig,
    trials: Sequence[Trial],
    peaks: Sequence[Peaks],
    belief: Belief,
) -> tuple[Trial, ...]:
    """The trials with the spread that the model predicts; ``peaks`` are those of all experiments.

    Friction takes more of the climb's torque than of theirs: what it hides there is in the spread.
    """
    found = []
    for trial in trials:
        climb = excerpt(config, trial, 1)
        own = np.maximum(peaks_of(config, climb, belief).motion, 1e-300)
        whole = highest([peaks[k].motion for k in trial.covers], len(config.axes))
        spread = np.clip(whole / own, 1.0, LARGEST_SPREAD)
        _, share = trial_shares(config, trial.experiment)
        at_share = replace(climb, torque=frozen_float(share * climb.torque))
        sticks, slides = (
            np.abs([m.position, m.velocity]).max(axis=1)
            for m in (
                foretold_motion(config, at_share, belief),
                foretold_motion(config, at_share, replace(belief, coulomb=0.0 * belief.coulomb)),
            )
        )
        hidden = np.clip(slides / np.maximum(sticks, 1e-300), 1.0, MOST_GROWTH)
        single = spread * np.concatenate((hidden, np.ones((1, len(config.axes)))))
        found.append(
            replace(trial, spread=frozen_float(single), usual=frozen_float(single), is_foretold=True)
        )
    return tuple(found)


def foretold_doublets(
    config: CellConfig, experiments: Sequence[PlannedExperiment], belief: Belief
) -> tuple[Doublet | None, ...]:
    """A doublet for each shaken axis that tells its signs and its weight: as long as a rigid axis is weighed
    with, longer where it would not show, shorter where it would go far. ``None`` where none does, or the axis
    is held."""
    found: list[Doublet | None] = [None] * len(config.axes)
    for i in {i for e in experiments for i in e.excited}:
        amplitude, _ = sign_amplitude(config, experiments, i)
        settings = config.axes[i]
        most = SIGN_MOST * settings.limits.position
        least = min(ENOUGH * SIGN_COUNTS * (settings.position_per_count or 0.0), most)
        length = SLOW_S
        for _ in range(DOUBLETS):
            wave = amplitude * excitation.doublet(round(length / config.bus.cycle_s))
            moved = foretold_motion(config, doublet_torque(config, i, wave, FREE_HZ), belief).position[:, i]
            far = float(np.abs(moved).max())
            if least <= far <= most:
                found[i] = Doublet(length, amplitude * length**2 / (16 * far))
                break
            length = length / 1.2 if far > most else min(1.2 * length, SIGN_LAST_S)
    return tuple(found)


def model_forecast(
    config: CellConfig, experiments: Sequence[PlannedExperiment], peaks: Sequence[Peaks], belief: Belief
) -> tuple[AxisForecast, ...]:
    """The announcement from a model."""
    bounds = highest([p.bound for p in peaks], len(config.axes))
    for i in sorted({i for e in experiments for i in e.excited}):
        first, _ = sign_amplitude(config, experiments, i)
        doublet = sign_doublet(config, i, first, float(belief.inertia[i]))
        more = np.array([[DOUBLETS_MOTION], [DOUBLETS_MOTION], [DOUBLETS_TORQUE]])
        bounds = np.maximum(bounds, more * peaks_of(config, doublet, belief).bound)
        swung = peaks_of(config, sign_doublets(config, i, first, float(belief.inertia[i])), belief)
        bounds[1] = np.maximum(bounds[1], swung.motion[1])
        bounds[0, i] = max(bounds[0, i], SIGN_TRAVEL * config.axes[i].limits.position)
    for i, axis in enumerate(config.axes):
        bounds[2, i] += READING_NOISE * (axis.rated_torque or axis.limits.torque)
        if axis.gravity_loaded is not False:
            bounds[2, i] = axis.limits.torque  # what gravity asks for is only known when it hangs
    return announced(config, np.minimum(bounds, limits_of(config)), "model")


def limit_forecast(
    config: CellConfig, experiments: Sequence[PlannedExperiment], share: float
) -> tuple[AxisForecast, ...]:
    """The announcement where nothing is known: the sweep keeps below this share of the limits.

    ``share`` is the share of the amplitude that was asked for: a plant that may use its whole window at full
    amplitude uses no more of it at less. What a drive needs to hold its axis while others move is not known:
    it has its whole torque. A path is followed as it is, whatever the amplitude.
    """
    bounds, most = limits_of(config), limits_of(config)
    bounds[0] *= max(share, SIGN_TRAVEL)
    for i, axis in enumerate(config.axes):
        if axis.inertia is not None:
            # √(A·x/m), the speed of a mass that a doublet of torque A moves by x; half of it may be the motor
            doublet = np.sqrt(config.safety.test_amplitude * bounds[2, i] * bounds[0, i] / axis.inertia)
            bounds[1, i] *= max(share, min(2.0 * DOUBLETS_MOTION * float(doublet) / bounds[1, i], 1.0))
    paths = [e.reference for e in experiments if e.reference is not None]
    cycle = config.bus.cycle_s
    bounds[0] += np.max([np.abs(p).max(axis=0) for p in paths], axis=0, initial=0.0)
    bounds[1] += np.max([np.abs(np.diff(p, axis=0)).max(axis=0) / cycle for p in paths], axis=0, initial=0.0)
    return announced(config, np.minimum(bounds, most), "limits")


def limits_of(config: CellConfig) -> Float64:
    """(3, M) limits of travel, velocity and torque."""
    return np.array([[a.limits.position, a.limits.velocity, a.limits.torque] for a in config.axes]).T


def usable(config: CellConfig) -> Float64:
    """(3, M) what may be planned with: the limits less a little, torque less the noise of its reading."""
    most = USABLE_SHARE * limits_of(config)
    room = READING_NOISE * np.array([a.rated_torque or a.limits.torque for a in config.axes])
    most[2] = np.maximum(most[2] - room, 0.5 * most[2])
    return most


def announced(config: CellConfig, bounds: Float64, basis: str) -> tuple[AxisForecast, ...]:
    """Return the (3, M) announced bounds in words."""
    return tuple(
        AxisForecast(
            axis=axis.name,
            unit="N" if config.linear else "N·m",
            peak_torque=float(bounds[2, i]),
            travel=float(bounds[0, i]),
            velocity=float(bounds[1, i]),
            power=float(bounds[2, i] * bounds[1, i]),
            travel_limit=axis.limits.position,
            basis=basis,
        )
        for i, axis in enumerate(config.axes)
    )


QUANTITIES = (sentence("travel"), sentence("velocity"), sentence("torque"))


def fitted(
    config: CellConfig,
    experiments: Sequence[PlannedExperiment],
    belief: Belief,
    share: float = 1.0,
    lowered: Float64 | None = None,
) -> tuple[tuple[PlannedExperiment, ...], list[Peaks], list[str]]:
    """The experiments with as much torque as the limits allow by the model, their peaks, and what was done.

    Where an excited axis would leave a limit its own torque is lowered, in every experiment alike so that
    they go on complementing each other; where a held axis would, that of those which shake it. Experiments
    that have a ``share`` of their torque keep that share of what could be planned, unless they follow a path.
    ``lowered`` (M,): what each axis keeps of it already, for the words.
    """
    count = len(config.axes)
    kept = np.ones(count) if lowered is None else lowered
    most = usable(config)
    factor, binding = np.ones(count), dict[int, str]()
    peaks = [peaks_of(config, e, belief) for e in experiments]
    for _ in range(ROUNDS):
        lower = np.ones(count)
        for e, p in zip(experiments, peaks, strict=True):
            if not e.torque.any():
                continue  # a slow move has no amplitude: its path was checked against the limits
            whole = p.motion if e.reference is not None else p.motion / share
            over = whole / np.maximum(most - p.friction, most / 2)
            for i in np.flatnonzero(over.max(axis=0) > 1.0):
                for j in e.excited if i not in e.excited else (int(i),):
                    if 1.0 / over[:, i].max() < lower[j]:
                        lower[j] = 1.0 / over[:, i].max()
                        what = QUANTITIES[int(over[:, i].argmax())]
                        binding[j] = sentence("{what} of {axis}", what=what, axis=config.axes[i].name)
        if lower.min() >= 1.0:
            break
        # a hair more, so that rounds end
        factor *= np.where(lower < 1.0, 0.99 * lower, 1.0)
        changed = {int(j) for j in np.flatnonzero(lower < 1.0)}
        scaled = [_scale_experiment(e, factor) if changed & set(e.excited) else None for e in experiments]
        peaks = [p if e is None else peaks_of(config, e, belief) for e, p in zip(scaled, peaks, strict=True)]
    result = tuple(_scale_experiment(e, factor) for e in experiments)
    said = [
        sentence(
            "axis {axis}: its torque is planned at {share:.0%} of what the config asks for, so "
            "that the {why} stays within its limit by {source}",
            axis=config.axes[j].name,
            share=share * kept[j] * factor[j],
            why=why,
            source=belief.source,
        )
        for j, why in sorted(binding.items())
        if factor[j] < 1.0
    ]
    return result, peaks, said


def _scale_experiment(e: PlannedExperiment, factor: Float64) -> PlannedExperiment:
    """Return the experiment with every torque, and the travel of a creep, times the factor of its axis."""
    if factor.min() >= 1.0:
        return e
    path = e.reference
    if path is not None and e.torque.any():
        # a creep turns round earlier at the same speed
        most = factor * np.abs(path).max(axis=0)
        path = np.where(most > 0, _fold_path(path, most), path)
    return replace(e, torque=frozen_float(e.torque * factor), reference=path)


def _fold_path(path: Float64, most: Float64) -> Float64:
    distance = np.cumsum(np.abs(np.diff(path, axis=0, prepend=path[:1])), axis=0)
    result: Float64 = most * (1.0 - np.abs(np.mod(distance / np.where(most > 0, most, 1.0) + 1.0, 4.0) - 2.0))
    return result


def turning_back(config: CellConfig, experiment: PlannedExperiment, belief: Belief) -> list[str]:
    """Axes whose creep is too slow to keep them from turning back while they are shaken, in words."""
    if experiment.reference is None:
        return []
    free = replace(belief, coulomb=np.zeros(len(config.axes)))
    motion = foretold_motion(config, replace(experiment, reference=None), free)
    swing = np.sqrt(np.mean(motion.velocity**2, axis=0))
    creep = np.abs(np.diff(experiment.reference, axis=0)).max(axis=0, initial=0.0) / config.bus.cycle_s
    unit = "m/s" if config.linear else "rad/s"
    return [
        sentence(
            "axis {axis}: it creeps at {creep:.3g} {unit} and is shaken with {swing:.3g} "
            "{unit} rms: it will turn back and stand; a creep_velocity of {creep_ratio:.2g} "
            "keeps it going",
            axis=axis.name,
            creep=creep[i],
            unit=unit,
            swing=swing[i],
            creep_ratio=CREEP_RATIO * swing[i],
        )
        for i, axis in enumerate(config.axes)
        if 0 < creep[i] < CREEP_RATIO * swing[i]
    ]


def fit_to_limits(plan: Plan, planned: CellConfig, tighter: CellConfig) -> Plan:
    """The plan with the torque of an axis scaled down where it exceeds the tighter limit.

    ``planned`` is the config that the plan was made with, ``tighter`` the one with the limits that hold: the
    share of the limit stays the same. Travel and velocity are not touched: the trial at low amplitude scales
    every torque down where they would come near their limits, and the watch knows the tighter ones.
    """
    old = np.array([a.limits.torque for a in planned.axes])
    new = np.array([a.limits.torque for a in tighter.axes])
    peak = plan.peak_torque
    share = np.where(peak > new, np.minimum(new / old, new / np.maximum(peak, 1e-300)), 1.0)
    if np.all(share == 1.0):
        return plan
    forecast = tuple(
        replace(f, peak_torque=f.peak_torque * float(s), travel_limit=a.limits.position)
        for f, s, a in zip(plan.forecast, share, tighter.axes, strict=True)
    )
    return replace(lower_torque(plan, share), forecast=forecast)


def lower_torque(plan: Plan, share: Float64) -> Plan:
    """The plan with a share (M,) of the torque of each axis; what is announced stays a bound."""
    if share.min() >= 1.0:
        return plan
    trials = tuple(replace(t, experiment=scale_torque([t.experiment], share)[0]) for t in plan.trials)
    return replace(plan, experiments=scale_torque(plan.experiments, share), trials=trials)


def scale_torque(experiments: Sequence[PlannedExperiment], share: Float64) -> tuple[PlannedExperiment, ...]:
    """The experiments with a share (M,) of the torque of each axis, their paths as they are."""
    if share.min() >= 1.0:
        return tuple(experiments)
    return tuple(replace(e, torque=frozen_float(e.torque * share)) for e in experiments)
