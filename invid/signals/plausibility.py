"""Checks before any fit: axes that never move, torque of the wrong sign."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.errors import InputError, NotIdentifiableError
from invid.model.document import Model
from invid.numerics.arrays import Float64
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.recording.plausibility import missing_sign
from invid.signals.record import Record, make_record

STRETCHES, LINES_PER_STRETCH = 8, 6
"""Stretches that a record's lines are cut into, and lines that each has at least."""
LEAST_SLOPES = 5
"""Stretches with a slope that stands out before anything is said. A machine's reactance falls across its
poles alone, and a chain of four masses has three."""
FALLING_SHARE = 0.9
"""Share of them that has to fall for the wrong sign."""


def check_units(model: Model, recording: Recording) -> None:
    """Raise InputError where one is rotary and the other linear."""
    if model.linear != recording.linear:
        raise InputError(
            f"{recording.source}: positions are in {recording.position_unit}, the model's masses in "
            f"{'kg' if model.linear else 'kg·m²'}; one is rotary, the other linear"
        )


def check_shaken(recording: Recording) -> None:
    """Return where every axis is shaken above its noise, by torque of the right sign.

    Raises
    ------
    InputError
        An axis that is never shaken, a channel that never changes, torque of the wrong sign or without one.
    NotIdentifiableError
        An excitation that drowns in the noise.
    """
    shaken = [
        e for e in recording.experiments if e.role is Role.IDENTIFY and e.kind is not Kind.CONSTANT_VELOCITY
    ]
    if not shaken:
        raise InputError(
            f"{recording.source}: no experiment with role 'identify' that shakes an axis; "
            f"found {len(recording.experiments)} experiments"
        )
    records = [make_record(e, recording.encoder_resolution) for e in shaken]
    for i, axis in enumerate(recording.axes):
        driving = [r for r in records if r.driven[i]]
        if not driving:
            raise InputError(
                f"{recording.source}: axis {axis} is never excited (no experiment names it as excited_axis "
                "or excites several); measure it too, or leave the axis out of the recording"
            )
        if not any(_has_signal(r, i) for r in driving):
            # Named as excited, so the recording is no bad input: the excitation drowned in the noise.
            raise NotIdentifiableError(
                f"{recording.source}: the excitation of axis {axis} is too weak: neither its torque nor its "
                f"position rises above the noise in experiments {[r.key for r in driving]}",
                way_out="raise the amplitude or measure longer",
                code="excitation_too_weak",
                axis=axis,
                values={"experiments": [r.key for r in driving]},
            )
        _check_channels(recording, i, [e for e, r in zip(shaken, records, strict=True) if r.driven[i]])
        _check_sign(recording, i, records)
    if not any(r.carrying.size for r in records):
        raise NotIdentifiableError(
            f"{recording.source}: no excited line found in any experiment", code="no_excited_line"
        )


def _has_signal(r: Record, axis: int) -> bool:
    """Return whether torque or position on excited lines rises above its noise, and is not constant."""
    # Mean power of noise lines is the floor with relative error 1/√lines; five times it is no noise.
    return any(
        bool(np.any(lines)) and bool(np.mean(np.abs(lines) ** 2) > 5.0 * noise[axis])
        for lines, noise in (
            (r.closed_position[r.carrying, axis], r.position_noise),
            (r.torque[r.carrying, axis], r.torque_noise),
        )
    )


def _check_channels(recording: Recording, i: int, driven: Sequence[Experiment]) -> None:
    """InputError for an axis whose position or torque never changes, or whose torque has lost its sign."""
    axis = recording.axes[i]
    if not any(np.ptp(e.position[:, i]) > 0 for e in recording.experiments):
        raise InputError(
            f"{recording.source}: the position of axis {axis} never changes in any experiment; see that "
            "its encoder counts and its brake is open, or leave the axis out of the recording"
        )
    if not any(np.ptp(e.torque[:, i]) > 0 for e in driven):
        raise InputError(
            f"{recording.source}: the torque of axis {axis} never changes, not even where the axis is "
            "shaken; see that the drive reports it (0x6077 in a PDO) and that it is the column meant"
        )
    if _has_lost_sign(np.concatenate([e.torque[:, i] for e in recording.experiments])):
        raise InputError(
            f"{recording.source}: the torque of axis {axis} has lost its sign: it leaps by the range of "
            f"its numbers where it should pass zero; import it with 'read_as: int16' beside its 'column'"
        )


def _check_sign(recording: Recording, i: int, records: Sequence[Record]) -> None:
    """InputError where torque and position of an axis have opposite signs."""
    slopes = [_reactance_slopes(r, i) for r in records]
    every = np.concatenate(slopes)
    # A late torque turns the phase as well, but not where frequencies are low.
    lowest = all(own[0] < 0 for own in slopes if own.size)
    if every.size < LEAST_SLOPES or not lowest or np.mean(every < 0) <= FALLING_SHARE:
        return
    fault = (
        f"{recording.source}: torque and position of axis {recording.axes[i]} have opposite signs: its "
        f"reactance falls with frequency in {int((every < 0).sum())} of {every.size} stretches of lines, and "
        "that of a machine rises (Foster). "
    )
    other = _axis_moved_instead(records, i)
    if other is None:
        raise InputError(fault + "Turn one of the two round (in an import map: sign: -1)")
    raise InputError(
        f"{fault}So it is where an axis is held: the experiments that name it as excited_axis shake "
        f"{recording.axes[other]} more; see that they name the axis that was shaken"
    )


def _has_lost_sign(wave: Float64) -> bool:
    """Whether torque (n,) is 0x6077, a signed number of 16 bits, read without its sign."""
    steps = np.diff(np.unique(wave))
    return bool(steps.size) and missing_sign(np.round(wave / float(np.median(steps)))) == "int16"


def _axis_moved_instead(records: Sequence[Record], axis: int) -> int | None:
    """Another axis that moves more in every record that names ``axis`` than in its own records, if any."""

    def moved(j: int, named: int) -> list[float]:
        seen = (r.closed_position[r.carrying, j] for r in records if r.driven[named])
        return [float(np.sum(np.abs(lines) ** 2)) for lines in seen]

    for j in range(records[0].hold.size):
        here, own = moved(j, axis), moved(j, j)
        if j != axis and here and own and min(here) > max(own):
            return j
    return None


def _reactance_slopes(r: Record, axis: int) -> Float64:
    """Slopes over frequency of the reactance Im(T/V) in stretches of lines, where they stand out.

    Foster's theorem: of a passive machine it rises everywhere between its poles, whatever springs, masses and
    holds there are. Only where the axis is driven alone is T/V that of a passive machine. What the line
    through a stretch leaves is its noise, friction's distortion included; four standard deviations stand out.
    """
    position = r.closed_position[r.carrying, axis]
    moved = np.abs(position) > 0
    if not r.driven[axis] or r.driven.sum() > 1:
        return np.zeros(0)
    w = r.wide[r.carrying][moved]
    reactance = -(r.torque[r.carrying, axis][moved] / position[moved]).real / w
    out = []
    for part in np.array_split(np.arange(w.size), max(min(STRETCHES, w.size // LINES_PER_STRETCH), 1)):
        if part.size < LINES_PER_STRETCH:
            continue
        x = w[part] - w[part].mean()
        slope = float(x @ reactance[part] / (x @ x))
        left = reactance[part] - reactance[part].mean() - slope * x
        std = float(np.sqrt(left @ left / (part.size - 2) / (x @ x)))
        if abs(slope) > 4.0 * std:
            out.append(slope)
    return np.array(out)
