"""When the torque of a hold acts: with the command, or inside the drive half a sample before it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from invid.arrays import Float64
from invid.distributions import chi2_isf
from invid.refine.blocks import driven_and_held, hold_laws, hold_offset, problem_from_spectra
from invid.refine.covariance import spread_of
from invid.refine.problem import MissingTorqueProblem
from invid.refine.solver import Solution, gauss_newton
from invid.spectra import LineSpectra


def placed_holds(
    problem: MissingTorqueProblem, solution: Solution, spectra: Sequence[LineSpectra]
) -> tuple[MissingTorqueProblem, Solution, dict[str, str]]:
    """What the holds do while their axis is driven, where no recorded demand tells.

    Two cells give the same data: (a) hold and command are held over the sample alike; (b) the hold
    runs inside the drive, continuous, beside a command held over the sample, and then acts half a
    sample earlier. With hold gains P, D they differ by a viscous friction P·h/2 and a motor inertia
    D·h/2, exactly (less where the drive's loop is slow). Friction tells them apart: where it is zero
    with (a), or on all axes with one common earliness, that is taken; where neither, the half sample
    stays open and its effect goes into the covariance.
    """
    structure = problem.structure
    names = [hold_offset(structure.axes[i]) for i in driven_and_held(spectra)]
    laws = hold_laws(spectra, driven_and_held(spectra))
    step = 1.0 / spectra[0].sample_rate_hz
    spread = spread_of(solution)
    at = {name: k for k, name in enumerate(problem.names)}
    open_axes, decided = [], {}
    for i, name in zip(driven_and_held(spectra), names, strict=True):
        if i not in laws or any(s.staircase[i] == 1.0 for s in spectra):
            continue
        offset, error = solution.p[at[name]], spread[at[name]]
        if abs(offset) > max(4.0 * error, 0.1 * step):
            decided[structure.axes[i]] = "hold and command act at different times; no hold while driven"
            continue
        open_axes.append(i)
    if not open_axes:
        return problem, solution, decided
    motors = np.array(open_axes)
    viscous = np.array([solution.p[structure.slices["viscous"].start + i] for i in motors])
    error = np.array([spread[structure.slices["viscous"].start + i] for i in motors])
    shift = np.array([laws[i][0] * step / 2 for i in motors])
    if np.all(shift < error):
        return problem, solution, decided
    early = 2.0 / step * shift  # viscous friction a second of earliness looks like
    without = float(np.sum((viscous / error) ** 2))
    common = float(np.sum(viscous * early / error**2) / np.sum((early / error) ** 2))
    common_error = float(1.0 / np.sqrt(np.sum((early / error) ** 2)))
    within = float(np.sum(((viscous - early * common) / error) ** 2))
    # 3 standard deviations' worth of false rejection; one degree of freedom goes into the common time.
    limit = chi2_isf(0.0027, motors.size)
    tight = chi2_isf(0.0027, motors.size - 1) if motors.size > 1 else 0.0
    fixed = [hold_offset(structure.axes[i]) for i in open_axes]
    if without < limit:
        priors = {**problem.priors, **dict.fromkeys(fixed, (0.0, 1e-3 * step))}
        text = "as the command, held over the sample"
        freed = replace(problem, priors=priors)
    else:
        holds = {i: laws[i] for i in open_axes}
        blocks = problem_from_spectra(
            structure, spectra, boundary=[b.transient for b in problem.blocks], holds=holds
        ).blocks
        blocks = tuple(
            replace(new, columns=old.columns, covariance=old.covariance)
            for new, old in zip(blocks, problem.blocks, strict=True)
        )
        if within < tight and 0.0 < common < 0.55 * step:
            prior, text = (-common, common_error), f"inside the drive, {common:.3g} s before the command"
        else:
            prior, text = (-step / 4, step / 4), "open: inside the drive or held over the sample"
        freed = replace(problem, blocks=blocks, priors={**problem.priors, **dict.fromkeys(fixed, prior)})
    decided |= {structure.axes[i]: text for i in open_axes}
    start = solution.p.copy()
    for name in fixed:
        start[at[name]] = freed.priors[name][0]
    return freed, gauss_newton(freed, start), decided


def hold_timing(
    problem: MissingTorqueProblem,
    solution: Solution,
    covariance: Float64,
    spectra: Sequence[LineSpectra],
    placed: Collection[str],
) -> dict[str, float]:
    """Standard deviations added to motor masses where a hold works at an unknown place while driven.

    A hold inside the drive acts half a sample before one that is held over the sample with the command.
    Recorded as one torque, the two differ by P·h/2 of viscous friction and, with the hold's damping D,
    by D·h/2 of motor inertia; where no record shows the hold alone (axes ``placed`` by ``placed_holds``)
    nothing tells them apart, unless the friction that comes out is too small to hold P·h/2. D is not in
    the recording: holds are damped near critically, D ≈ 2·√(P·S) with S the branch sum. ``covariance``
    is widened in place by half of D·h/2.
    """
    structure = problem.structure
    values, spread = structure.physical(solution.p[: structure.count]), spread_of(solution)
    first, added = structure.slices["viscous"].start, {}
    for i, (dof, size) in enumerate(zip(structure.motor_dofs, structure.sizes, strict=True)):
        known = any(s.staircase[i] == 1.0 or s.hold_torque is not None for s in spectra)
        if known or not structure.viscous or structure.axes[i] in placed:
            continue
        if f"{structure.axes[i]}.coulomb" in problem.column_names:
            continue  # a motor that rubs: its viscous part is friction's, and no sign of the hold
        step = 1.0 / min(s.sample_rate_hz for s in spectra)
        friction = float(values[first + i])
        error = float(spread[first + i]) if np.isfinite(spread[first + i]) else 0.0
        gains = np.array([s.hold_gain[i] for s in spectra if s.hold_gain.size > i])
        if gains.size == 0 or not np.any(np.isnan(gains) | (gains > 0)):
            continue
        gain = float(np.nanmax(gains)) if np.any(gains > 0) else 2.0 * max(friction, 0.0) / step
        if gain <= 0 or friction + 3.0 * error < 0.25 * gain * step:
            continue
        own = 0.5 * float(np.sqrt(gain * values[dof : dof + size].sum())) * step
        covariance[dof, dof] += own**2
        added[structure.axes[i]] = own
    return added
