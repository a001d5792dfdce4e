"""When the torque of a hold acts: with the command, or inside the drive half a sample before it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from math import comb

import numpy as np

from invid.likelihood.covariance import parameter_std
from invid.likelihood.levenberg_marquardt import Solution, gauss_newton
from invid.likelihood.records import (
    add_columns,
    driven_and_held,
    hold_laws,
    hold_offset,
    problem_from_spectra,
    transfer_parameters,
)
from invid.likelihood.residual import MissingTorqueProblem
from invid.numerics.arrays import Float64
from invid.numerics.distributions import chi2_isf, chi2_sf, normal_sf
from invid.signals.smooth_command import find_smooth_hold
from invid.signals.spectra import LineSpectra

INSIDE = "inside the drive"
"""Beginning of the statement that a hold acts inside the drive."""
OPEN = (".open_hold.stiffness", ".open_hold.damping")
"""Endings of the names of the gains of a hold of unknown location."""


def locate_holds(
    problem: MissingTorqueProblem, solution: Solution, spectra: Sequence[LineSpectra]
) -> tuple[MissingTorqueProblem, Solution, dict[str, str]]:
    """The fit with each hold placed inside the drive, with the command, or open, and the statements about it.

    Two cells give the same data: (a) hold and command are held over the sample alike; (b) the hold runs
    inside the drive, continuous, beside a command held over the sample, and then acts half a sample earlier.
    With hold gains P, D they differ by a viscous friction P·h/2 and a motor inertia D·h/2, exactly (less
    where the drive's loop is slow). Friction tells them apart: where it is zero with (a), or on all axes with
    one common lead, that is taken; otherwise the half sample stays open and its effect goes into the
    covariance.
    """
    structure = problem.structure
    names = [hold_offset(structure.axes[i]) for i in driven_and_held(spectra)]
    laws = hold_laws(spectra, driven_and_held(spectra))
    step = 1.0 / spectra[0].sample_rate_hz
    spread = parameter_std(solution)
    at = {name: k for k, name in enumerate(problem.names)}
    open_axes, statements = [], {}
    for i, name in zip(driven_and_held(spectra), names, strict=True):
        if i not in laws or any(s.staircase[i] == 1.0 for s in spectra):
            continue
        offset, error = solution.p[at[name]], spread[at[name]]
        if abs(offset) > max(4.0 * error, 0.1 * step):
            statements[structure.axes[i]] = "hold and command act at different times; no hold while driven"
            continue
        open_axes.append(i)
    if not open_axes:
        return problem, solution, statements
    motors = np.array(open_axes)
    viscous = np.array([solution.p[structure.slices["viscous"].start + i] for i in motors])
    error = np.array([spread[structure.slices["viscous"].start + i] for i in motors])
    shift = np.array([laws[i][0] * step / 2 for i in motors])
    if np.all(shift < error):
        return problem, solution, statements
    early = 2.0 / step * shift  # viscous friction that looks like a lead of one second
    without = float(np.sum((viscous / error) ** 2))
    common = float(np.sum(viscous * early / error**2) / np.sum((early / error) ** 2))
    common_error = float(1.0 / np.sqrt(np.sum((early / error) ** 2)))
    within = float(np.sum(((viscous - early * common) / error) ** 2))
    # 3 standard deviations' worth of false rejection; one degree of freedom goes into the common time.
    limit = chi2_isf(0.0027, motors.size)
    tight = chi2_isf(0.0027, motors.size - 1) if motors.size > 1 else 0.0
    fixed = [hold_offset(structure.axes[i]) for i in open_axes]
    # The images of a command held over the sample alias into the sampled torque of a damped hold: of
    # the command's torque jω·D·h²/(12·m), which looks like so much of a time offset.
    values = structure.physical(solution.p[: structure.count])
    alias = [float(laws[i][1] * step**2 / 12.0 / values[structure.motor_dofs[i]]) for i in open_axes]

    def priors_for(mean: float, std: float) -> dict[str, tuple[float, float]]:
        return {name: (mean, float(np.hypot(std, a))) for name, a in zip(fixed, alias, strict=True)}

    if without < limit:
        priors = {**problem.priors, **priors_for(0.0, 1e-3 * step)}
        text = "as the command, held over the sample"
        located = replace(problem, priors=priors)
    else:
        holds = {i: laws[i] for i in open_axes}
        blocks = problem_from_spectra(
            structure, spectra, boundary=[b.transient for b in problem.blocks], holds=holds
        ).blocks
        blocks = tuple(
            replace(new, columns=old.columns, noise=old.noise)
            for new, old in zip(blocks, problem.blocks, strict=True)
        )
        if within < tight and 0.0 < common < 0.55 * step:
            found, text = priors_for(-common, common_error), f"{INSIDE}, {common:.3g} s before the command"
        else:
            found, text = priors_for(-step / 4, step / 4), "open: inside the drive or held over the sample"
        located = replace(problem, blocks=blocks, priors={**problem.priors, **found})
    statements |= {structure.axes[i]: text for i in open_axes}
    start = solution.p.copy()
    for name in fixed:
        start[at[name]] = located.priors[name][0]
    return located, gauss_newton(located, start), statements


def free_hold_locations(
    problem: MissingTorqueProblem,
    solution: Solution,
    spectra: Sequence[LineSpectra],
    placed: Collection[str],
) -> tuple[MissingTorqueProblem, Solution, tuple[str, ...], dict[str, str]]:
    """The problem with the hold of each axis in the fit whose place is unknown while the axis is driven.

    A hold −(P + jωD)θ inside the drive acts half a sample before one that is held over the sample with
    the command. Recorded as one torque, the two differ by (z − 1)(P + jωD)θ with z what holding
    over the sample does: to first order P·h/2 of viscous friction and D·h/2 of motor inertia. Where no
    record shows the hold alone (axes ``placed`` by ``locate_holds``) nothing tells them apart, unless the
    friction that comes out is too small to hold P·h/2. Both gains then enter as parameters known to lie
    somewhere between nothing (held over the sample) and the whole gain (inside the drive), so that every
    parameter's standard deviation contains what they may cost. All axes are asked together: the holds of a
    cell run in its drives or in its master, and friction too small on two axes speaks for the third
    (``are_holds_sampled``); an axis whose friction stands out of its error stays open. Where it is on several
    axes what their holds make of it by acting earlier, by one time alike, they run in the drives
    (``common_early_share``), and their gains count whole.

    A command recorded at the end of the sample it is held over acts before its record; a hold inside the
    drive, recorded as it acts, is then late by as much, and looks like negative friction and inertia
    (``_later_share``). Both ends count where nothing tells them apart.

    Both gains are read off the command where that is smooth over frequency (``smooth_command``), also
    where the recording says that the axis is free. Otherwise P is that of the recording, or bounded by
    friction where it is not said (a hold inside the drive); D is never said: holds are damped near
    critically, D ≈ 2·√(P·S) with S the branch sum.
    """
    structure = problem.structure
    values, spread = structure.physical(solution.p[: structure.count]), parameter_std(solution)
    first = structure.slices["viscous"].start
    step = 1.0 / spectra[0].sample_rate_hz
    at = {name: k for k, name in enumerate(problem.names)}
    laws: dict[int, tuple[float, float]] = {}
    seen: set[int] = set()
    frictions: dict[int, tuple[float, float, float]] = {}
    for i, (dof, size) in enumerate(zip(structure.motor_dofs, structure.sizes, strict=True)):
        if not structure.viscous or structure.axes[i] in placed or _is_told_by_demand(spectra, i):
            continue
        half = 0.5 / min(s.sample_rate_hz for s in spectra)
        friction = float(values[first + i])
        error = float(spread[first + i]) if np.isfinite(spread[first + i]) else 0.0
        stated = _stated_gains(spectra, i)
        law = find_smooth_hold(spectra, i)
        if law is None:
            if not np.any(np.isnan(stated) | (stated > 0)):
                continue
            # One standard deviation of friction above none: a small P still comes with a D that counts.
            gain = float(np.nanmax(stated)) if np.any(stated > 0) else (max(friction, 0.0) + error) / half
            if gain <= 0:
                continue
            law = gain, 2.0 * float(np.sqrt(gain * values[dof : dof + size].sum()))
        else:
            seen.add(i)
        laws[i] = law
        frictions[i] = friction, error, law[0] * half
    are_sampled = are_holds_sampled(list(frictions.values()))
    gains: dict[int, tuple[float, float]] = {}
    shares: dict[int, float] = {}
    lowest: dict[int, float] = {}
    common = common_early_share([frictions[i] for i in frictions if i in seen])
    for i, seen_friction in frictions.items():
        later = _later_share(float(solution.p[at[f"{structure.axes[i]}.time_offset"]]), step)
        reach = _open_range(seen_friction, are_sampled=are_sampled, later=later)
        if reach is None:
            continue
        gains[i] = laws[i]
        shares[i], lowest[i] = reach if common is None or i not in seen else (common[0], 0.0)
    if not gains:
        return problem, solution, (), {}
    names: list[str] = []
    priors: dict[str, tuple[float, float]] = {}
    for i, law in gains.items():
        for ending, gain in zip(OPEN, law, strict=True):
            names.append(structure.axes[i] + ending)
            priors[names[-1]] = gain * (1.0 + lowest[i]) / 2, gain * (1.0 - lowest[i]) / 2
            if common is not None and i in seen:
                priors[names[-1]] = gain, gain * common[1] / common[0]
    columns = []
    for block, s in zip(problem.blocks, spectra, strict=True):
        part = np.zeros((block.omega.size, structure.motors, len(names)), dtype=complex)
        jw, half = 1j * block.omega, block.step / 2
        loss = block.folding.zoh_loss
        for number, i in enumerate(gains):
            if not s.driven[i]:
                continue
            late = solution.p[at[f"{structure.axes[i]}.time_offset"]]
            command = np.exp(-jw * late) * (1.0 - abs(shares[i]) * loss)
            acting = (np.exp(-jw * (late - shares[i] * half)) - command) * block.position[:, i]
            part[:, i, 2 * number] = acting
            part[:, i, 2 * number + 1] = jw * acting
        columns.append(np.concatenate((block.columns, part), axis=2))
    larger = add_columns(problem, columns, (*problem.column_names, *names))
    larger = replace(larger, priors={**problem.priors, **priors})
    found = gauss_newton(larger, transfer_parameters(problem, solution.p, larger))
    inside = {i for i in gains if common and i in seen}
    text = f"{INSIDE}, {common[0] * step / 2:.3g} s before the command" if common else ""
    return (
        larger,
        found,
        tuple(structure.axes[i] for i in gains if i not in inside),
        {structure.axes[i]: text for i in inside},
    )


def _stated_gains(spectra: Sequence[LineSpectra], axis: int) -> Float64:
    """Gains that the recording states for the hold of an axis while it is driven; NaN inside the drive."""
    return np.array([s.untimed_hold[axis] for s in spectra if s.untimed_hold.size > axis and s.driven[axis]])


def _is_told_by_demand(spectra: Sequence[LineSpectra], axis: int) -> bool:
    """Whether a logged demand tells when the hold of an axis acts: it lies beside it, or there is none.

    A demand that is all of the torque holds the hold's part as well, and says nothing of when that acts.
    """
    stated = _stated_gains(spectra, axis)
    is_logged = any(s.staircase[axis] == 1.0 or s.hold_torque is not None for s in spectra)
    if is_logged and not np.any(np.isnan(stated) | (stated > 0)):
        return True
    return any(_has_hold_beside(s, axis) for s in spectra)


def _has_hold_beside(s: LineSpectra, axis: int) -> bool:
    """Whether a demand is logged without what the hold of a driven axis gives, well above the noise."""
    if s.hold_torque is None or not s.driven[axis]:
        return False
    power = np.abs(s.hold_torque[s.excited, axis]) ** 2
    # The mean power of noise lines has a relative error of 1/√lines; five times it is no noise.
    return bool(power.size and power.mean() > 5.0 * s.floor[s.axis_count + axis])


def _later_share(late: float, step: float) -> float:
    """Share of half a sample by which a hold inside the drive may act later than a command ``late`` [s].

    None where the command acts as recorded or after it; a tenth of a sample is the offsets' own error.
    """
    return 0.0 if late > -0.1 * step else min(-2.0 * late / step, 1.0)


def _open_range(
    friction: tuple[float, float, float], *, are_sampled: bool, later: float
) -> tuple[float, float] | None:
    """Share of half a sample by which a hold may act earlier than the command (negative: later) at most, and
    what the other end is of it; ``None`` where it acts with the command. ``friction`` as in
    ``are_holds_sampled``.

    The hold's P makes friction of at most what there is: it bounds the early share. Below a half of it,
    friction that does not stand out of its error speaks for none.
    """
    size, error, whole = friction
    early = min(1.0, (size + 3.0 * error) / whole)
    if size < 3.0 * error and (are_sampled or early < 0.5):
        early = 0.0
    if max(early, later) == 0.0:
        return None
    return (early, -later / early) if early >= later else (-later, -early / later)


def gains_beyond_range(problem: MissingTorqueProblem, solution: Solution) -> dict[int, float]:
    """Gains of open holds that left their range, by parameter number, with the end of the range that they
    crossed.

    A gain is at least zero (or as far below as the hold may act later) and at most the whole gain. Beyond,
    something that the model lacks (gradual reversals of friction) biases it, and would bias the motor's mass
    as well: empirical, 9 to 24 % too large with holds of a negative damping.
    """
    out = {}
    for k, name in enumerate(problem.names):
        if not name.endswith(OPEN) or not solution.free[k]:
            continue
        mean, std = problem.priors[name]
        reach = max(mean, std)
        end = float(np.clip(solution.p[k], mean - reach, mean + reach))
        if end != solution.p[k]:
            out[k] = end
    return out


def common_early_share(axes: Sequence[tuple[float, float, float]]) -> tuple[float, float] | None:
    """Common share of half a sample by which the holds of all axes act early, with its standard deviation.

    ``axes`` as in ``are_holds_sampled``. ``None`` for a single axis, where friction is not the same share of
    P·h/2 on all axes (statistical: wrong once in 370), where it is not significant, or more than holds cause.
    """
    if len(axes) < 2 or any(error <= 0 for _, error, _ in axes):
        return None
    friction, error, whole = np.array(axes).T
    weight = float(np.sum((whole / error) ** 2))
    share, std = float(np.sum(friction * whole / error**2)) / weight, 1.0 / float(np.sqrt(weight))
    chi2 = float(np.sum(((friction - share * whole) / error) ** 2))
    if chi2 > chi2_isf(0.0027, len(axes) - 1) or share < 3.0 * std or share > 1.0 + 3.0 * std:
        return None
    return share, std


def are_holds_sampled(axes: Sequence[tuple[float, float, float]]) -> bool:
    """Whether viscous friction is too small on all axes together for holds that run inside the drives.

    ``axes`` gives each axis' viscous friction, its standard deviation, and P·h/2, which a hold inside the
    drive looks like. Its loop runs at least twice a sample and acts at least half of that earlier. Friction
    is not negative, so a negative one (friction that the model lacks) counts as zero. Statistical: wrong once
    in 740, three standard deviations, one-sided; of several axes, each is too small by chance in half the
    cases.
    """
    shortfall = sum(
        (max(0.5 * whole - max(friction, 0.0), 0.0) / error) ** 2 if error > 0 else np.inf
        for friction, error, whole in axes
        if whole > 0
    )
    count = len(axes)
    if shortfall <= 0:
        return False
    chance = sum(comb(count, k) / 2.0**count * chi2_sf(shortfall, k) for k in range(1, count + 1))
    return chance < normal_sf(3.0)
