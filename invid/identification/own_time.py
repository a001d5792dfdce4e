"""Torque that keeps its own time: missing on the lines between those of a period, as tones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from invid.effects.units import unit_of
from invid.likelihood.unknown_forces.fitted_hypothesis import FittedHypothesis
from invid.likelihood.unknown_forces.smoother import smooth
from invid.model.diagnosis_document import Unexplained
from invid.model.plant import Plant
from invid.numerics.arrays import Bool, Complex128, Float64
from invid.recording.model import Recording
from invid.signals.record import DENSE, Record
from invid.signals.tones import FAINT, Tone, find_tones, refine_tones, tone_phasors
from invid.wording.sentence import sentence

CHANGED = 2.0
"""Missing power over the sensors' between the lines of a period from which a machine changes within a record
(empirical: that of noise is one within a tenth)."""


@dataclass(frozen=True)
class AxisTones:
    """Tones in the torque that an axis misses in every periodic record, of the record that shows most."""

    axis: int
    tones: tuple[Tone, ...]

    @property
    def power(self) -> float:
        """Mean square [(N·m)² or N²]."""
        return sum(0.5 * t.amplitude**2 for t in self.tones)


def tones_of(found: FittedHypothesis) -> list[AxisTones]:
    """Axes whose missing torque holds a tone in all records of two periods and more, the strongest first."""
    by_axis: dict[int, list[tuple[list[Tone], float]]] = {}
    own_hz = _own_frequencies(found.numbers.plant)
    for record, missing, sensors, free in _between_periods(found):
        for m in range(missing.shape[1]):
            tones = find_tones((missing[:, m], sensors[:, m], free), record.span, own_hz)
            by_axis.setdefault(m, []).append((tones, 1.0 / record.span))
    out = [AxisTones(m, _in_every(found)) for m, found in by_axis.items()]
    return sorted((a for a in out if a.tones), key=lambda a: -a.power)


def _own_frequencies(plant: Plant) -> Float64:
    """Frequencies of the loads with all motors held [Hz]: what the records' ends left of them, a wrong plant
    shows as missing."""
    stiffness, _, mass = plant.matrices
    if not plant.structure.inner:
        return np.zeros(0)
    inner = np.ix_(plant.structure.inner, plant.structure.inner)
    squares = eigh(stiffness[inner], mass[inner], eigvals_only=True)
    out: Float64 = np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)
    return out


def changes_within(found: FittedHypothesis) -> bool:
    """Return whether a record misses torque between the lines of its period far above its sensors: the
    machine is another one from one period to the next."""
    return any(
        bool(((np.abs(missing[free]) ** 2 / sensors[free]).mean(axis=0) > CHANGED).any())
        for _, missing, sensors, free in _between_periods(found)
    )


def _between_periods(found: FittedHypothesis) -> Iterator[tuple[Record, Complex128, Float64, Bool]]:
    """Records of two periods and more, missing torque (A, M), power of the sensors (A, M), and which lines
    (A,) of the band lie between those of the period."""
    for smoothed in smooth(found.fit.problem, found.fit.value):
        for record, missing in zip(smoothed.stack.records, smoothed.missing, strict=True):
            if record.periods > 1:
                number = np.arange(record.wide.size)
                free = (number % record.periods != 0) & (record.wide <= 2 * np.pi * DENSE * record.top_hz)
                yield record, missing, smoothed.sensors, free


def sized(tones: Sequence[AxisTones], recording: Recording, plant: Plant) -> tuple[AxisTones, ...]:
    """The tones with the amplitude of the torque that acts on a plant fitted without them, the largest of all
    records; those far below the strongest, which a plant fitted beside it made, go."""
    out = []
    for axis in tones:
        hz = refine_tones(recording, [t.hz for t in axis.tones])
        stiffness = plant.condense(2 * np.pi * np.array(hz)).stiffness
        motors = stiffness.shape[1]
        sizes = np.zeros(len(hz))
        for e in recording.experiments:
            if e.periods > 1:
                phasors = tone_phasors(e, hz)
                position, torque = phasors[:, :motors], phasors[:, motors:]
                acts = (stiffness @ position[..., None])[..., 0] - torque
                sizes = np.maximum(sizes, np.abs(acts[:, axis.axis]))
        kept = tuple(Tone(f, float(a)) for f, a in zip(hz, sizes, strict=True) if a > FAINT * sizes.max())
        out.append(AxisTones(axis.axis, kept))
    return tuple(sorted(out, key=lambda a: -a.power))


def _in_every(records: Sequence[tuple[list[Tone], float]]) -> tuple[Tone, ...]:
    """Tones of the first record that all others hold within a line, at their largest amplitude."""
    first, width = records[0]
    least = FAINT * max((t.amplitude for t in first), default=0.0)
    first = [t for t in first if t.amplitude >= least]
    out = []
    for tone in first:
        same = [[t for t in tones if abs(t.hz - tone.hz) < max(width, other)] for tones, other in records]
        if all(same):
            out.append(max((t for part in same for t in part), key=lambda t: t.amplitude))
    return tuple(out)


def describe_tones(found: Sequence[AxisTones], recording: Recording) -> Unexplained | None:
    """Axis, amplitude and frequencies of the strongest tones, in words; ``None`` without tones."""
    if not found:
        return None
    first = found[0]
    name, unit = recording.axes[first.axis], unit_of("torque", recording.linear)
    hz = tuple(sorted(float(f"{t.hz:.4g}") for t in first.tones))
    where = ", ".join(f"{f:.3g}" for f in hz)
    size = max(t.amplitude for t in first.tones)
    said = sentence(
        "Axis {axis}: a torque of {size:.2g} {unit} at {where} Hz keeps its own time and "
        "repeats with none of the periods (time-dependent): a fan, a pump, another "
        "machine, or a loop that hunts; no cause of the catalogue does.",
        axis=name,
        size=size,
        unit=unit,
        where=where,
    )
    return Unexplained(axis=name, frequencies_hz=hz, character=("time-dependent",), sentence=said)
