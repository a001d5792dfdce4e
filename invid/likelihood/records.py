"""Spectra to the blocks of the fit: lines, delays, holds, and their first noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from invid.likelihood.nuisance.torque_channel import Block
from invid.likelihood.residual import MissingTorqueProblem
from invid.model.parameters import ChainStructure
from invid.numerics.arrays import Bool, Complex128, Float64
from invid.signals.spectra import LineSpectra

HOLD_OFFSET = ".hold_time_offset"
"""Ending of the names of the additional delays of holding torques."""


def problem_from_spectra(
    structure: ChainStructure,
    spectra: Sequence[LineSpectra],
    *,
    boundary: Sequence[bool] | None = None,
    holds: Mapping[int, tuple[float, float]] | None = None,
) -> MissingTorqueProblem:
    """The problem of fitting ``structure`` to the records.

    Parameters
    ----------
    boundary
        Per record, whether it carries boundary terms; default where the spectra say so. Such a record is
        fitted on all lines up to the highest excited one, others on the excited lines.
    holds
        Gains (P, D) of holds that work beside the command while their axis is driven.
    """
    motors = structure.motors
    both = driven_and_held(spectra)
    laws = {} if holds is None else holds
    unknown = [i for i in range(motors) if any(np.isnan(s.staircase[i]) for s in spectra)]
    blocks = []
    for number, s in enumerate(spectra):
        transient = s.transient if boundary is None else boundary[number]
        used = used_lines(s, everything=transient)
        further = []
        hold = np.zeros((int(used.sum()), motors), dtype=complex)
        for i in range(motors):
            beside = bool(s.driven[i]) and i in laws
            further.append(motors + both.index(i) if i in both and (beside or not s.driven[i]) else -1)
            if beside:
                hold[:, i] = laws[i][0] + 1j * s.omega[used] * laws[i][1]
        blocks.append(
            Block(
                key=s.key,
                omega=s.omega[used],
                position=s.position[used],
                torque=s.torque[used],
                noise=s.line_floor[used],
                span=s.span_s,
                transient=transient,
                ends_in=s.periods == 1 and s.transient,
                further_index=tuple(further),
                hold=hold,
                staircase_index=tuple(
                    unknown.index(i) if np.isnan(s.staircase[i]) else -1 for i in range(motors)
                ),
                staircase=np.nan_to_num(s.staircase, nan=0.0),
                step=1.0 / s.sample_rate_hz,
                columns=np.zeros((int(used.sum()), motors, 0), dtype=complex),
                stepped=None if s.stepped is None else s.stepped[used],
                integrated=s.integrated,
            )
        )
    axes = structure.axes
    stairs = tuple(f"{axes[i]}.held_over_sample" for i in unknown)
    return MissingTorqueProblem(
        structure,
        tuple(blocks),
        delay_names=tuple([f"{a}.time_offset" for a in axes] + [hold_offset(axes[i]) for i in both]),
        staircase_names=stairs,
        # Torque is held over the sample (1), continuous (0), or smoothed in between.
        priors=dict.fromkeys(stairs, (0.5, 0.5)),
    )


def hold_offset(axis: str) -> str:
    """Name of the additional delay of an axis' holding torque."""
    return f"{axis}{HOLD_OFFSET}"


def driven_and_held(spectra: Sequence[LineSpectra]) -> list[int]:
    """Axes that are driven in some records and not in others.

    Their torque gets two delays: that of a position loop inside the drive has its own sampling.
    """
    driven = np.array([s.driven for s in spectra])
    return [i for i in range(driven.shape[1]) if driven[:, i].any() and not driven[:, i].all()]


def used_lines(s: LineSpectra, *, everything: bool) -> Bool:
    """(F,) the lines of the spectra that enter the fit."""
    lines: Bool = np.array(s.excited, dtype=bool)
    if everything:
        top = np.flatnonzero(lines)
        lines = np.arange(lines.size) <= (top[-1] if top.size else -1)
    return lines


def hold_laws(spectra: Sequence[LineSpectra], axes: Sequence[int]) -> dict[int, tuple[float, float]]:
    """Proportional and derivative gain of each axis' hold, from the records in which it is held.

    There torque = −(P + jωD)·position; least squares over the excited lines, weighted by the torque noise.
    Axes without such a law (free, or stiffer than the data show) are left out.
    """
    laws: dict[int, tuple[float, float]] = {}
    for i in axes:
        rows, right = [], []
        for s in spectra:
            if s.driven[i]:
                continue
            lines = used_lines(s, everything=False)
            weight = 1.0 / np.sqrt(s.floor[s.axis_count + i])
            theta = s.position[lines, i] * weight
            rows.append(np.stack((-theta, -1j * s.omega[lines] * theta), axis=1))
            right.append(s.torque[lines, i] * weight)
        matrix, target = np.concatenate(rows), np.concatenate(right)
        real = np.concatenate((matrix.real, matrix.imag))
        goal = np.concatenate((target.real, target.imag))
        if goal.size < 6 or not np.any(goal):
            continue
        (gain, damping), *_ = np.linalg.lstsq(real, goal, rcond=None)
        left = goal - real @ np.array([gain, damping])
        # The law is accepted where it explains nine tenths of the held axis' torque.
        if float(left @ left) < 0.1 * float(goal @ goal) and gain > 0:
            laws[i] = (float(gain), float(damping))
    return laws


def add_columns(
    problem: MissingTorqueProblem, columns: Sequence[Complex128], names: Sequence[str]
) -> MissingTorqueProblem:
    """The problem with torque-side columns (F, M, L) per block, one shared coefficient each."""
    blocks = tuple(replace(b, columns=c) for b, c in zip(problem.blocks, columns, strict=True))
    return replace(problem, blocks=blocks, column_names=tuple(names))


def transfer_parameters(old: MissingTorqueProblem, p: Float64, new: MissingTorqueProblem) -> Float64:
    """Parameters of ``new`` by name from those of ``old``; new names start at their neutral value."""
    start = new.start(np.zeros(new.structure.count))
    known = dict(zip(old.names, p, strict=True))
    return np.array([known.get(name, value) for name, value in zip(new.names, start, strict=True)])
