"""What is left at a place without a name: how large, at which frequencies, what it goes with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from invid.clauses import dependent_on, element_phrase
from invid.diagnosis.unknown_forces.left_over import PlaceForce, place_of
from invid.effects.supposed.law import SpotMotion
from invid.effects.units import unit_of
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.forces import Spot
from invid.likelihood.unknown_forces.smoother import SmoothedStack
from invid.model.diagnosis_document import Unexplained
from invid.numerics.arrays import Float64
from invid.recording.model import Recording
from invid.wording.sentence import Figure, joined, sentence

FOLLOWS = 0.2
"""Share of a force's power from which it is said to follow something (empirical)."""
EVEN, ODD = 0.15, 0.3
"""Shares of its power on even and on odd lines of a period from which it is called so (empirical)."""
RANGES, LINES = 24, 6
"""Ranges of position and velocity over which a force is averaged; lines that are said."""
ALIKE = 2.0
"""Ratio of shares of the torque between the smallest and the largest motion from which a force depends on the
amplitude (empirical)."""


@dataclass(frozen=True, eq=False)
class RecordForce:
    """The smoothed force at a place in one record, and the motion there, on the grid of motion (k,) each.

    ``power`` (A,) of its lines ``hz``; ``periods`` of the record, 0 where it has none; ``share`` of the
    torque's rms.
    """

    force: Float64
    position: Float64
    velocity: Float64
    hz: Float64
    power: Float64
    periods: int
    share: float


def describe_left(
    found: FittedHypothesis, forces: Sequence[PlaceForce], recording: Recording
) -> Unexplained | None:
    """The strongest force that is sure to be left, in words; ``None`` where none is."""
    sure = [f for f in forces if f.is_sure]
    if not sure:
        return None
    worst = max(sure, key=lambda f: f.rms)
    axis, element, other = place_of(found.hypothesis.structure, worst.spot)
    records = record_forces(found, worst.spot)
    frequencies, character = frequencies_of(records), character_of(records)
    name, unit = recording.axes[axis], unit_of("torque", recording.linear)
    between = "" if other is None else sentence(" towards {axis}", axis=recording.axes[other])
    lines = joined([Figure(f"{hz:.3g}") for hz in frequencies])
    said = sentence(
        "Axis {axis}: a force of {rms:.2g} {unit} rms acts at {element}{between}{most} "
        "({character}), that no "
        "cause of the catalogue explains.",
        axis=name,
        rms=worst.rms,
        unit=unit,
        element=element_phrase(element),
        between=between,
        most=sentence(", most at {frequencies} Hz", frequencies=lines) if frequencies else "",
        character=joined(character),
    )
    return Unexplained(name, frequencies, character, said)


def record_forces(found: FittedHypothesis, spot: Spot) -> list[RecordForce]:
    """The smoothed force at a place in every record fitted."""
    number = found.fit.problem.spots.number[spot]
    motions = iter(found.motions.flat(spot))
    smoothed = found.smoothed().motions.smoothed
    return [
        _of_record(stack, k, number, next(motions)) for stack in smoothed for k in range(stack.stack.count)
    ]


def _of_record(stack: SmoothedStack, k: int, number: int, motion: SpotMotion) -> RecordForce:
    record = stack.stack.records[k]
    lines = stack.force[k, :, number]
    torque = float(np.std(record.torque_wave))
    wave = stack.force_over_time(number)[k]
    return RecordForce(
        wave,
        motion.position,
        motion.velocity,
        record.wide / (2 * np.pi),
        np.abs(lines) ** 2,
        record.periods,
        float(np.std(wave)) / max(torque, 1e-300),
    )


def frequencies_of(records: Sequence[RecordForce]) -> tuple[float, ...]:
    """Lines on which the force is strong, ascending [Hz]."""
    power: dict[float, float] = {}
    for r in records:
        for hz, p in zip(r.hz.tolist(), r.power.tolist(), strict=True):
            power[round(hz, 4)] = power.get(round(hz, 4), 0.0) + p
    return tuple(sorted(sorted((hz for hz in power if hz > 0), key=lambda hz: -power[hz])[:LINES]))


def character_of(records: Sequence[RecordForce]) -> tuple[str, ...]:
    """What the contract says a force without a name is like."""
    whole = sum(float(r.power[1:].sum()) for r in records) + 1e-300
    even, odd = 0.0, 0.0
    for r in records:
        if r.periods:
            of_period = np.arange(r.power.size) / r.periods
            is_line = (of_period == np.round(of_period)) & (of_period > 0)
            even += float(r.power[is_line & (of_period % 2 == 0)].sum())
            odd += float(r.power[is_line & (of_period % 2 == 1)].sum())
    follows = follows_what(records)
    said = [sentence("even")] * (even > EVEN * whole) + [sentence("odd")] * (odd > ODD * whole)
    by_size = [r.share for r in sorted(records, key=lambda r: float(np.std(r.position)))]
    # What changes from record to record by the clock says nothing of their amplitudes.
    if follows != "time-dependent" and len(by_size) > 1:
        ratio = by_size[0] / max(by_size[-1], 1e-300)
        said += [dependent_on("amplitude")] * (not 1.0 / ALIKE < ratio < ALIKE)
    return tuple(dict.fromkeys([*said, follows]))


def follows_what(records: Sequence[RecordForce]) -> str:
    """What a force goes with over time: position, velocity, slow time, or the amplitude where none of them.

    Judged by the share of its power in its mean over ranges of position or of velocity, record by record, or
    in the mean and slope of each record. What is constant throughout goes with none.
    """
    constant = float(np.concatenate([r.force for r in records]).mean())
    names = [dependent_on(q) for q in ("position", "velocity", "time")]
    power = dict.fromkeys(names, 0.0)
    total = 1e-300
    for r in records:
        total += float(np.sum((r.force - constant) ** 2))
        level = float(r.force.mean())
        own, ramp = r.force - level, np.linspace(-1.0, 1.0, r.force.size)
        slope = float(own @ ramp) ** 2 / float(ramp @ ramp)
        power["time-dependent"] += r.force.size * (level - constant) ** 2 + slope
        for name, x in zip(names, (r.position, r.velocity), strict=False):
            ranges = np.array_split(own[np.argsort(x)], RANGES)
            power[name] += float(sum(b.size * b.mean() ** 2 for b in ranges))
    name = max(power, key=lambda k: power[k])
    return name if power[name] > FOLLOWS * total else dependent_on("amplitude")
