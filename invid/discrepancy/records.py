"""The records a diagnosis works on: spectra for training, spectra kept out, and the problems they pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.arrays import frozen_float
from invid.errors import NotIdentifiableError
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.refine.blocks import problem_from_spectra
from invid.refine.problem import Block, MissingTorqueProblem
from invid.refine.structure import ChainStructure
from invid.spectra import LineSpectra, spectra_of

DELAY_STD = 3.0
"""Samples: width of the prior of each axis' time offset. It only keeps an offset that the data do not see
from running away; one that they see is moved by less than a thousandth of a sample."""


@dataclass(frozen=True, eq=False)
class Part:
    """Records of one role."""

    spectra: tuple[LineSpectra, ...]
    spans: tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False)
class Records:
    """Training and held-out records of one recording."""

    train: Part
    held_out: Part
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Problems:
    """The missing torque of the training and of the held-out records; both share one parameter vector."""

    structure: ChainStructure
    records: Records
    train: MissingTorqueProblem
    held_out: MissingTorqueProblem


def split(recording: Recording) -> Records:
    """Training and held-out spectra.

    Held out are the experiments with role "validate"; without any, the last period of each record, or
    the last records, or the second half of a single one, and a warning says so.
    """
    usable = [e for e in recording.experiments if e.kind is not Kind.CONSTANT_VELOCITY]
    if not usable:
        raise NotIdentifiableError(
            f"{recording.source}: no experiment shakes an axis; a diagnosis needs a multisine, chirp or "
            "stepped sine"
        )
    train = [e for e in usable if e.role is Role.IDENTIFY]
    kept = [e for e in usable if e.role is Role.VALIDATE]
    if not train:
        train, kept = usable, []
    pairs = [(spectra_of(e), _span(e)) for e in train]
    warnings = [w for s, _ in pairs for w in s.warnings]
    if kept:
        val = [(spectra_of(e), _span(e)) for e in kept]
        return Records(_part(pairs), _part(val), tuple(warnings))
    periodic = [(s, span) for s, span in pairs if s.deviations.shape[0] >= 2]
    if periodic:
        warnings.append(
            "no experiment has the role validate: the last period of each record was kept out of the fit "
            "instead, which shares its excitation; a record at another amplitude would test the result harder"
        )
        first, last = [], []
        for s, span in pairs:
            if s.deviations.shape[0] >= 2:
                a, b = _without_last(s)
                first.append((a, span))
                last.append((b, span))
            else:
                first.append((s, span))
        return Records(_part(first), _part(last), tuple(warnings))
    if len(pairs) > recording.axis_count:
        warnings.append("no experiment has the role validate: the last record was kept out of the fit")
        return Records(_part(pairs[:-1]), _part(pairs[-1:]), tuple(warnings))
    warnings.append(
        "no experiment has the role validate and none repeats: the second half of each record was kept out of "
        "the fit; a second record at another amplitude would test the result harder"
    )
    halves = [_halves(e) for e in train]
    return Records(
        _part([(spectra_of(a), _span(a)) for a, _ in halves]),
        _part([(spectra_of(b), _span(b)) for _, b in halves]),
        tuple(warnings),
    )


def _part(pairs: Sequence[tuple[LineSpectra, tuple[float, float]]]) -> Part:
    return Part(tuple(s for s, _ in pairs), tuple(span for _, span in pairs))


def _span(e: Experiment) -> tuple[float, float]:
    return float(e.time[0]), float(e.time[-1])


def _without_last(s: LineSpectra) -> tuple[LineSpectra, LineSpectra]:
    """The mean of all periods but the last, and the last alone, with the covariances of each."""
    periods = s.deviations.shape[0]
    motors = s.axis_count
    mean = np.concatenate((s.position, s.torque), axis=1)
    first = mean + s.deviations[:-1].mean(axis=0)
    last = mean + s.deviations[-1]
    single = s.covariance * periods

    def with_mean(values: np.ndarray, covariance: np.ndarray, count: int) -> LineSpectra:
        return replace(
            s,
            position=values[:, :motors],
            torque=values[:, motors:],
            covariance=covariance,
            floor=s.floor * periods / count,
            periods=count,
            span_s=s.span_s * count / periods,
        )

    return with_mean(first, single / (periods - 1), periods - 1), with_mean(last, single, 1)


def _halves(e: Experiment) -> tuple[Experiment, Experiment]:
    middle = e.samples // 2

    def part(rows: slice) -> Experiment:
        return replace(
            e,
            time=frozen_float(e.time[rows]),
            position=frozen_float(e.position[rows]),
            torque=frozen_float(e.torque[rows]),
            torque_demand=None if e.torque_demand is None else frozen_float(e.torque_demand[rows]),
            status=None,
            period_samples=0,
        )

    return part(slice(0, middle)), part(slice(middle, None))


def problems(structure: ChainStructure, records: Records) -> Problems:
    """The problems on all lines up to the highest excited one, line 0 of driven axes included."""
    train, kept = records.train.spectra, records.held_out.spectra
    both = problem_from_spectra(structure, [*train, *kept], lines="all", noise="spectra")
    blocks = tuple(
        _with_mean(b, s) if not b.transient else b for b, s in zip(both.blocks, [*train, *kept], strict=True)
    )
    step = max(b.step for b in blocks)
    priors = {**both.priors, **dict.fromkeys(both.delay_names, (0.0, DELAY_STD * step))}
    count = len(train)
    whole = replace(both, priors=priors)
    return Problems(
        structure,
        records,
        replace(whole, blocks=blocks[:count]),
        replace(whole, blocks=blocks[count:], priors={}),
    )


def _with_mean(block: Block, s: LineSpectra) -> Block:
    """Line 0 added: over whole periods the mean torque of a driven axis is that of what resists it.

    A held axis may stand on its static friction, so its mean says nothing and gets no weight.
    """
    motors = block.position.shape[1]
    mean = np.asarray(s.torque_wave).mean(axis=0)
    torque = np.sqrt(2.0) * mean[None].astype(complex)
    covariance = block.covariance[:1].copy()
    for i in range(motors):
        if not s.driven[i]:
            at = motors + i
            covariance[0, at, at] += 1e8 * (mean[i] ** 2 + np.abs(block.torque[:, i]).max() ** 2)
    zero = np.zeros((1, motors), dtype=complex)
    return replace(
        block,
        omega=np.concatenate(([0.0], block.omega)),
        position=np.concatenate((zero, block.position)),
        torque=np.concatenate((torque, block.torque)),
        covariance=np.concatenate((covariance, block.covariance)),
        hold=np.concatenate((block.hold[:1].real * 0j + 0, block.hold)),
        columns=np.zeros((block.omega.size + 1, motors, 0), dtype=complex),
    )
