"""A torque at one frequency that repeats with no period: removed from a recording, measured, described."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.model.diagnosis_document import Unexplained
from invid.numerics.arrays import Complex128
from invid.recording.model import Recording
from invid.signals.spectral_record import SpectralRecord


@dataclass(frozen=True, eq=False)
class Tone:
    """A sinusoidal torque on one axis in one record, with its phasors in all channels."""

    axis: int
    frequency_hz: float
    amplitude: float
    """Amplitude of the torque [N·m or N]."""
    channels: Complex128
    """(2M,) phasors of positions and torques: each holds Re(phasor·e^{2πjf(t − start)})."""
    start: float
    key: str


def remove_tones(recording: Recording, tones: Sequence[Tone]) -> Recording:
    """The recording with the tones subtracted from its channels."""
    experiments = []
    for e in recording.experiments:
        position, torque = e.position.copy(), e.torque.copy()
        for t in tones:
            if t.key == e.key:
                rotation = np.exp(2j * np.pi * t.frequency_hz * (e.time - t.start))
                both = (rotation[:, None] * t.channels).real
                position -= both[:, : position.shape[1]]
                torque -= both[:, position.shape[1] :]
        experiments.append(replace(e, position=position, torque=torque))
    return replace(recording, experiments=tuple(experiments))


def tone_power(tones: Sequence[Tone], axis: int, records: Sequence[SpectralRecord]) -> float:
    """Mean square [(N·m)² or N²] of the tones of an axis over these records."""
    keys = {r.key for r in records}
    total = sum(0.5 * t.amplitude**2 for t in tones if t.axis == axis and t.key in keys)
    return float(total) / max(len(keys), 1)


def describe_tones(tones: Sequence[Tone], recording: Recording, unit: str) -> Unexplained | None:
    """Axis, amplitude and frequencies of the strongest tones, in words; ``None`` without tones."""
    if not tones:
        return None
    first = max(tones, key=lambda t: t.amplitude)
    own = [t for t in tones if t.axis == first.axis]
    found = dict.fromkeys(float(f"{t.frequency_hz:.4g}") for t in sorted(own, key=lambda t: -t.amplitude))
    strongest = sorted(list(found)[:6])
    where = ", ".join(f"{hz:.3g}" for hz in strongest)
    name = recording.axes[first.axis]
    return Unexplained(
        axis=name,
        frequencies_hz=tuple(strongest),
        character=("time-dependent",),
        sentence=(
            f"Axis {name}: a torque of {first.amplitude:.2g} {unit} at {where} Hz keeps its own time and "
            "repeats with none of the periods (time-dependent): a fan, a pump, another machine, or a loop "
            "that hunts; no cause of the catalogue does."
        ),
    )
