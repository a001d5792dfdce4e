"""Axes that stand still throughout: nothing can be learnt of them, and they move nothing of the others."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from invid.numerics.arrays import Float64, frozen_float
from invid.recording.model import Experiment, Recording

FLICKER = 1.5
"""Counts of its encoder within which an axis stands: one count flickers at its edge."""
HUNTING = 8.0
"""Counts over which a position loop at rest hunts, between friction and its integrator (empirical)."""
NOISE = 10.0
"""Range of a million samples of white noise over its standard deviation."""
BESIDE = 1e-3
"""Share of the farthest travel of all axes below which hunting is at rest; more is a small motion."""


def moving_part(recording: Recording, axes: Collection[str] | None = None) -> tuple[Recording, list[str]]:
    """The recording without axes that stand still in every experiment and that none excites, and a sentence
    on each of them.

    An axis at rest exerts no force of inertia on the others, and its own torque tells nothing: the other axes
    are as if it were not there. ``axes``: those of a model, which stay whatever they do. Where no axis moves
    the recording stays as it is.
    """
    still = [i for i in _still_axes(recording) if axes is None or recording.axes[i] not in axes]
    kept = [i for i in range(recording.axis_count) if i not in still]
    if not still or not kept:
        return recording, []
    said = [
        f"{recording.axes[i]} stands still in every experiment: nothing is known of it, and the model is of "
        "the other axes; excite it as well to identify it"
        for i in still
    ]
    return _with_axes(recording, kept), said


def _still_axes(recording: Recording) -> list[int]:
    if not recording.experiments:
        return []
    named = {e.excited_axis for e in recording.experiments}
    counts = recording.encoder_resolution
    travel = np.max([np.ptp(e.position, axis=0) for e in recording.experiments], axis=0)
    most = np.zeros(recording.axis_count) if counts is None else FLICKER * counts
    # Beside one that moves far, an axis that its controller keeps in place hunts by some counts.
    hunted = np.max([_hunting(e, counts) for e in recording.experiments], axis=0)
    most = np.maximum(most, np.minimum(hunted, BESIDE * float(travel.max())))
    return [i for i in range(recording.axis_count) if i not in named and travel[i] <= most[i]]


def _hunting(e: Experiment, counts: Float64 | None) -> Float64:
    """(M,) travel that hunting and noise may make of an axis at rest."""
    steps = np.abs(np.diff(e.position, axis=0))
    if not steps.size:
        return np.zeros(e.position.shape[1])
    own = np.min(steps, axis=0, initial=np.inf, where=steps > 0.0)
    size = own if counts is None else np.where(np.isfinite(counts), counts, own)
    noise = np.std(np.diff(e.position, 2, axis=0), axis=0) / np.sqrt(6.0)
    return np.asarray(np.maximum(HUNTING * np.where(np.isfinite(size), size, 0.0), NOISE * noise))


def _with_axes(recording: Recording, kept: Sequence[int]) -> Recording:
    """The recording of these axes alone; experiments that excite another one excite none of these."""
    at = list(kept)
    counts, rated, resolution = (
        recording.masses_per_axis,
        recording.rated_torque,
        recording.encoder_resolution,
    )
    return replace(
        recording,
        axes=tuple(recording.axes[i] for i in at),
        experiments=tuple(_experiment_with_axes(e, at) for e in recording.experiments),
        masses_per_axis=None if counts is None else tuple(counts[i] for i in at),
        rated_torque=None if rated is None else frozen_float(rated[at]),
        encoder_resolution=None if resolution is None else frozen_float(resolution[at]),
    )


def _experiment_with_axes(e: Experiment, at: list[int]) -> Experiment:
    columns = {name: values[:, at] for name, values in e.datasets().items() if name != "time"}
    excited = at.index(e.excited_axis) if e.excited_axis in at else -1
    return replace(e, excited_axis=excited, hold_gain=e.hold_gain[at], **columns)


def masses_of_moving(
    masses: Sequence[int] | Literal["auto"] | None, whole: Recording, part: Recording
) -> Sequence[int] | Literal["auto"] | None:
    """Numbers of masses asked for, one for each axis of ``whole``, for those of ``part`` alone."""
    if masses is None or isinstance(masses, str) or len(masses) != whole.axis_count:
        return masses
    return [n for n, axis in zip(masses, whole.axes, strict=True) if axis in part.axes]
