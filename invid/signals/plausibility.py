"""Checks before any fit: axes that never move, torque of the wrong sign."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.errors import InputError, NotIdentifiableError
from invid.model.document import Model
from invid.numerics.arrays import Float64
from invid.recording.model import Recording, Role
from invid.recording.plausibility import missing_sign
from invid.signals.spectra import LineSpectra, all_spectra

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
    """Raise where a recording shows no machine that is shaken: see ``check_excitation``."""
    check_excitation(recording, all_spectra(recording, Role.IDENTIFY))


def check_excitation(recording: Recording, spectra: Sequence[LineSpectra]) -> None:
    """Return where every axis is shaken above its noise, by torque of the right sign.

    Raises
    ------
    InputError
        An axis that is never shaken, a channel that never changes, torque of the wrong sign.
    NotIdentifiableError
        An excitation that drowns in the noise.
    """
    if not spectra:
        raise InputError(
            f"{recording.source}: no experiment with role 'identify' that shakes an axis; "
            f"found {len(recording.experiments)} experiments"
        )
    motors = recording.axis_count
    # Where no axis is named, one that only its hold moves may still be told by the others' excitation.
    unnamed = {e.key for e in recording.experiments if not 0 <= e.excited_axis < motors}
    for i, axis in enumerate(recording.axes):
        driving = [s for s in spectra if s.driven[i] or s.key in unnamed]
        if not driving:
            raise InputError(
                f"{recording.source}: axis {axis} is never excited (no experiment names it as excited_axis "
                "or excites several); measure it too, or leave the axis out of the recording"
            )
        if not any(_has_signal(s, i) or _has_signal(s, motors + i) for s in driving):
            # Named as excited, so the recording is no bad input: the excitation drowned in the noise.
            raise NotIdentifiableError(
                f"{recording.source}: the excitation of axis {axis} is too weak: neither its torque nor its "
                f"position rises above the noise in experiments {[s.key for s in driving]}; "
                "raise the amplitude or measure longer"
            )
    check_plausible(recording, spectra)
    if not any(s.excited.any() for s in spectra):
        raise NotIdentifiableError(f"{recording.source}: no excited line found in any experiment")


def _has_signal(s: LineSpectra, channel: int) -> bool:
    """Return whether a channel's excited lines rise above its noise, and it is not constant."""
    both = np.concatenate((s.position, s.torque), axis=1)[s.excited, channel]
    if both.size == 0 or not np.any(both):
        return False
    # Mean power of noise lines is the floor with relative error 1/√lines; five times it is no noise.
    return bool(np.mean(np.abs(both) ** 2) > 5.0 * s.floor[channel])


def check_plausible(recording: Recording, spectra: Sequence[LineSpectra]) -> None:
    """InputError for an axis whose position or torque never changes, or whose torque has a wrong sign or
    none."""
    for i, axis in enumerate(recording.axes):
        if spectra and not any(np.ptp(s.position_wave[:, i]) > 0 for s in spectra):
            raise InputError(
                f"{recording.source}: the position of axis {axis} never changes in any experiment; see that "
                "its encoder counts and its brake is open, or leave the axis out of the recording"
            )
        driven = [s for s in spectra if s.driven[i]]
        if driven and not any(np.ptp(s.torque_wave[:, i]) > 0 for s in driven):
            raise InputError(
                f"{recording.source}: the torque of axis {axis} never changes, not even where the axis is "
                "shaken; see that the drive reports it (0x6077 in a PDO) and that it is the column meant"
            )
        if _has_lost_sign(np.concatenate([e.torque[:, i] for e in recording.experiments])):
            raise InputError(
                f"{recording.source}: the torque of axis {axis} has lost its sign: it leaps by the range of "
                f"its numbers where it should pass zero; import it with 'read_as: int16' beside its 'column'"
            )
        slopes = [_reactance_slopes(s, i) for s in spectra]
        every = np.concatenate(slopes) if slopes else np.zeros(0)
        # A late torque turns the phase as well, but not where frequencies are low.
        lowest = all(own[0] < 0 for own in slopes if own.size)
        if every.size >= LEAST_SLOPES and lowest and np.mean(every < 0) > FALLING_SHARE:
            fault = (
                f"{recording.source}: torque and position of axis {axis} have opposite signs: its reactance "
                f"falls with frequency in {int((every < 0).sum())} of {every.size} stretches of lines, and "
                "that of a machine rises (Foster). "
            )
            other = _axis_moved_instead(spectra, i)
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


def _axis_moved_instead(spectra: Sequence[LineSpectra], axis: int) -> int | None:
    """Another axis that moves more in every record that names ``axis`` than in its own records, if any."""

    def moved(j: int, named: int) -> list[float]:
        return [float(np.sum(np.abs(s.position[s.excited, j]) ** 2)) for s in spectra if s.driven[named]]

    for j in range(spectra[0].axis_count):
        here, own = moved(j, axis), moved(j, j)
        if j != axis and here and own and min(here) > max(own):
            return j
    return None


def _reactance_slopes(s: LineSpectra, axis: int) -> Float64:
    """Slopes over frequency of the reactance Im(T/V) in stretches of lines, where they stand out.

    Foster's theorem: of a passive machine it rises everywhere between its poles, whatever springs, masses and
    holds there are. Only where the axis is driven alone is T/V that of a passive machine. What the line
    through a stretch leaves is its noise, friction's distortion included; four standard deviations stand out.
    """
    lines = np.asarray(s.excited) & (np.abs(s.position[:, axis]) > 0)
    if not s.driven[axis] or s.driven.sum() > 1:
        return np.zeros(0)
    w = s.omega[lines]
    reactance = -(s.torque[lines, axis] / s.position[lines, axis]).real / w
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
