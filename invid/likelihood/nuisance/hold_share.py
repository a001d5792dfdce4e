"""Holds whose share inside their drive the data may not determine: a nuisance of every joint fit.

A hold −(P + jωD)θ that works inside its drive acts half a sample before one that is held over the sample with
the command. Recorded as one torque, the two differ by a viscous friction of P·h/2 and a motor inertia of
D·h/2, to first order. Where nothing tells which it is, the share that works inside is a parameter.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.likelihood.nuisance.hold_timing import INSIDE
from invid.likelihood.records import driven_and_held, hold_laws, hold_offset
from invid.model.document import Model
from invid.numerics.arrays import Complex128, Float64
from invid.recording.model import Recording
from invid.signals.smooth_command import find_smooth_hold
from invid.signals.spectra import LineSpectra

SHARES = (-0.1, 1.1)
"""Bounds of a share: none to all, and a tenth more for gains that differ from those of the law."""


@dataclass(frozen=True)
class InsideHold:
    """A hold of an axis whose share inside the drive is a parameter with a standard deviation of ½."""

    axis: int
    stiffness: float
    """P [torque per position]."""
    damping: float
    """D [torque per velocity]."""
    expected: float
    """Mean of the prior of the share."""
    records: frozenset[str]
    """Keys of the experiments in which it works."""

    @property
    def name(self) -> str:
        """Name of the parameter."""
        if self.damping == 0.0:
            return "stiffness_inside"
        return "hold_inside" if self.stiffness else "damping_inside"

    def law(self, omega: Float64) -> Complex128:
        """(F,) P + jωD."""
        return np.asarray(self.stiffness + 1j * omega * self.damping, dtype=np.complex128)


def find_inside_holds(
    spectra: Sequence[LineSpectra], model: Model, recording: Recording, *, with_command: bool
) -> tuple[InsideHold, ...]:
    """The holds of a recording; empty where the demand is logged beside them (``with_command``).

    The law of a hold that a record shows alone is read there. The gains of one that no record shows are
    parameters between zero and their plausible values.
    """
    if with_command:
        return ()
    offsets = model.fit.get("time_offset_s", {})
    step = 1.0 / spectra[0].sample_rate_hz
    out = []
    for i, (stiffness, damping) in hold_laws(spectra, driven_and_held(spectra)).items():
        entry = offsets.get(hold_offset(recording.axes[i])) if isinstance(offsets, dict) else None
        late = entry.get("value") if isinstance(entry, dict) else None
        share = 0.5 if late is None else -2.0 * float(late) / step
        # Without effects the identification may find a time that no hold has: an effect's doing.
        expected = share if SHARES[0] <= share <= SHARES[1] else 0.5
        out.append(InsideHold(i, stiffness, damping, expected, _experiments_with_hold(recording, spectra, i)))
    return tuple(out) + unseen_holds(spectra, model, recording, {h.axis for h in out})


def _experiments_with_hold(recording: Recording, spectra: Sequence[LineSpectra], axis: int) -> frozenset[str]:
    """Keys of the experiments in which the hold of an axis may work: not where it is free or follows a
    demand."""
    free = {e.key for e in recording.experiments if e.hold_gain[axis] == 0.0}
    return frozenset(
        s.key for s in spectra if not s.driven[axis] or (s.key not in free and s.staircase[axis] != 1.0)
    )


HOLD_BAND = 4.0
"""Highest frequency of a hold of unknown gain, over the first excited one. Empirical: excitation deeper
inside a hold's band only works against the hold."""
LEAST_EXCITATION = 0.02
"""Share of the torque's power below which the excitation has not begun; what is not periodic leaks below
(empirical)."""


def unseen_holds(
    spectra: Sequence[LineSpectra], model: Model, recording: Recording, seen: Collection[int] = ()
) -> tuple[InsideHold, ...]:
    """Holds that no record shows alone: they work whenever their axis is recorded, or rest while others move.

    ``seen``: axes of which a record shows it. Of the others those count whose hold the identification left
    open or placed inside the drive, or of which the model says nothing. Their gains are read off the command
    where that is smooth over frequency; else P is that of the recording or, where the hold is inside the
    drive, the stiffest plausible one, and D that of a critically damped one.
    """
    out = []
    for i in range(recording.axis_count):
        held, declared = driven_hold(recording, i)
        axis = recording.axes[i]
        inside = str((model.fit.get("holds") or {}).get(axis, "")).startswith(INSIDE)
        # A model that says nothing of its holds has not looked.
        unknown = "hold_timing" not in model.fit and all(s.driven[i] for s in spectra)
        if i in seen or not (unknown or inside or axis in (model.fit.get("hold_timing") or {})):
            continue
        if not held or any(s.staircase[i] == 1.0 for s in spectra):
            continue
        total = float(model.chains.masses[i].sum())
        bound = total * (HOLD_BAND * _first_frequency(spectra, i)) ** 2 if declared is None else declared
        law = (bound, 2.0 * float(np.sqrt(bound * total)))
        gains = find_smooth_hold(spectra, i) if declared is None else None
        if gains is not None:
            # P follows from the lowest lines alone, where chirps ripple; holds have a damping ratio above ½.
            law = max(gains[0], gains[1] ** 2 / total), gains[1]
        # A gain that the file states is the master's, by the contract: held over the sample as its command.
        expected = 0.5 if declared is None else 0.0
        keys = _experiments_with_hold(recording, spectra, i)
        if gains and inside:
            out.append(InsideHold(i, *gains, 1.0, keys))
            continue
        out.append(InsideHold(i, law[0], 0.0, expected, keys))
        out.append(InsideHold(i, 0.0, law[1], expected, keys))
    return tuple(out)


def holds_left_open(
    spectra: Sequence[LineSpectra], model: Model, recording: Recording
) -> tuple[InsideHold, ...]:
    """The holds that no record shows alone, of every axis: the identification closes them where it finds next
    to no friction, and would leave them open where there is some."""
    if any(s.hold_torque is not None for s in spectra):
        return ()
    seen = hold_laws(spectra, driven_and_held(spectra))
    unlocated = replace(model, fit={**model.fit, "holds": {}, "hold_timing": dict.fromkeys(recording.axes)})
    return unseen_holds(spectra, unlocated, recording, set(seen))


def driven_hold(recording: Recording, axis: int) -> tuple[bool, float | None]:
    """Whether a hold may work while an axis is driven, and its largest declared gain, if any."""
    gains = np.array([e.hold_gain[axis] for e in recording.experiments if e.excited_axis in (axis, -1)])
    declared = gains[np.isfinite(gains) & (gains > 0)]
    held = bool((np.isnan(gains) | (gains > 0)).any())
    return held, float(declared.max()) if declared.size else None


def _first_frequency(spectra: Sequence[LineSpectra], axis: int) -> float:
    """Lowest frequency [rad/s] at which the excitation of an axis begins."""
    lowest = []
    for s in spectra:
        if s.excited.any() and s.driven[axis]:
            power = np.cumsum(np.abs(s.torque[s.excited, axis]) ** 2)
            lowest.append(float(s.omega[s.excited][np.searchsorted(power, LEAST_EXCITATION * power[-1])]))
    return min(lowest, default=0.0)
