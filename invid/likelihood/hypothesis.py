"""The parameter vector of a joint fit, and the torque that acts at it: timing, holding, holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from invid.likelihood.nuisance.hold_share import InsideHold
from invid.model.parameters import ChainStructure
from invid.numerics.arrays import Bool, Complex128, Float64
from invid.signals.spectral_record import SpectralRecord


@dataclass(frozen=True, eq=False)
class Layout:
    """The parameter vector: structure, delay of each axis, share held over the sample of each axis, share of
    each hold that works inside its drive, time constant of each drive that smooths the torque it reports."""

    structure: ChainStructure
    step: float
    free_stairs: tuple[int, ...]
    known_stairs: Float64
    free_delays: tuple[int, ...]
    origin: float
    delayed: tuple[int, ...] = ()
    """Axes whose delay is an effect's."""
    holds: tuple[InsideHold, ...] = ()
    smoothed: tuple[int, ...] = ()
    """Axes whose recorded torque is low-passed, as the identification found."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        axes = self.structure.axes
        return (
            *self.structure.names,
            *(f"{axes[i]}.time_offset" for i in self.free_delays),
            *(f"{axes[i]}.held_over_sample" for i in self.free_stairs),
            *(f"{axes[h.axis]}.{h.name}" for h in self.holds),
            *(f"{axes[i]}.torque_smoothed" for i in self.smoothed),
        )

    @property
    def count(self) -> int:
        """n."""
        return int(self.smoothed_at.stop)

    @property
    def stairs_at(self) -> slice:
        """Where the shares held over the sample stand."""
        first = self.structure.count + len(self.free_delays)
        return slice(first, first + len(self.free_stairs))

    @property
    def holds_at(self) -> slice:
        """Where the shares of the holds stand."""
        return slice(self.stairs_at.stop, self.stairs_at.stop + len(self.holds))

    @property
    def smoothed_at(self) -> slice:
        """Where the time constants of reported torque stand."""
        return slice(self.holds_at.stop, self.holds_at.stop + len(self.smoothed))

    def unsmoothed(self, p: Float64, omega: Float64) -> Complex128:
        """(F, M) actual torque over one that the drive reports through a first-order lag."""
        out = np.ones((omega.size, self.structure.motors), dtype=complex)
        out[:, list(self.smoothed)] += 1j * omega[:, None] * p[self.smoothed_at]
        return out

    def delays(self, p: Float64) -> Float64:
        """(M,) [s]."""
        out = np.zeros(self.structure.motors)
        at = self.structure.count
        out[list(self.free_delays)] = p[at : at + len(self.free_delays)]
        return out

    @property
    def held_late(self) -> tuple[int, ...]:
        """Axes with a delay of an effect whose measured torque may be held over its sample.

        Holding acts half a sample late, which a free time offset takes up; beside a delay that is an effect's
        it stands for itself, or the effect would be half a sample too long. Where the torque is the recorded
        demand itself, the effect is how late it follows its command, holding included.
        """
        return tuple(i for i in self.delayed if i in self.free_stairs)

    def lateness(self, p: Float64, record: SpectralRecord) -> Float64:
        """(M,) how much later than recorded the torque acts [s], effects apart."""
        out = self.delays(p)
        if self.held_late and record.command is None:  # a demand beside a hold has its half sample of its own
            at = list(self.held_late)
            out[at] += 0.5 * self.step * self.stairs(p)[at]
        return out

    def stairs(self, p: Float64) -> Float64:
        """(M,) share of the torque that is held over each sample."""
        out = self.known_stairs.copy()
        out[list(self.free_stairs)] = p[self.stairs_at]
        return out

    def without_delay(self, axes: Sequence[int]) -> tuple[Layout, Bool]:
        """The layout with some axes' delays left to effects, and which parameters stay."""
        kept = tuple(i for i in self.free_delays if i not in axes)
        stay = np.ones(self.count, dtype=bool)
        for k, i in enumerate(self.free_delays):
            if i in axes:
                stay[self.structure.count + k] = False
        delayed = tuple(sorted({*self.delayed, *axes}))
        return replace(self, free_delays=kept, delayed=delayed), stay

    def with_delay(self, axis: int) -> Layout:
        """The layout with an axis' time offset free again that was left to an effect."""
        free = tuple(sorted((*self.free_delays, axis)))
        return replace(self, free_delays=free, delayed=tuple(i for i in self.delayed if i != axis))


@dataclass(frozen=True, eq=False)
class ActingTorque:
    """Torque that acts in a record, and how it changes."""

    torque: Complex128
    """(F, M)."""
    factor: Complex128
    """(F, M) what recorded torque is multiplied by."""
    by_stair: Complex128
    """(F, M) its derivative by the share held over the sample."""
    by_hold: Complex128
    """(F, holds) its derivative by each hold's share."""


def acting_torque(record: SpectralRecord, layout: Layout, p: Float64) -> ActingTorque:
    """The torque that acts.

    Holding a sample takes amplitude away and acts half a sample late. The time offset takes up the
    latter where all torque is alike. Where the demand is logged beside a hold, the demand is held over
    the sample (the contract says so) and ``stairs`` is the share of the rest that is.
    """
    w = record.omega
    delays, stairs = layout.lateness(p, record), layout.stairs(p)
    smear = record.folding.smear[:, None]
    z = np.exp(-1j * w[:, None] * delays) * layout.unsmoothed(p, w)
    factor = z * (1.0 - stairs * smear)
    by_hold = np.zeros((w.size, len(layout.holds)), dtype=complex)
    if record.command is None:
        acting = factor * record.torque
        by_stair = -z * smear * record.torque
        for k, (hold, share) in enumerate(zip(layout.holds, p[layout.holds_at], strict=True)):
            i = hold.axis
            if record.key not in hold.records:
                continue
            # Command E = T + HΘ and hold −HΘ act at different times: A·T + (A − z₂)·H·Θ, z₂ half a sample
            # earlier and not held over it.
            torque = hold.law(w) * record.position[:, i]
            by_hold[:, k] = (factor[:, i] - z[:, i] * np.exp(0.5j * w * record.step)) * torque
            acting[:, i] += share * by_hold[:, k]
            by_stair[:, i] -= share * (z * smear)[:, i] * torque
        return ActingTorque(acting, factor, by_stair, by_hold)
    rest = record.torque - record.command
    held = ((1.0 - smear) * np.exp(-0.5j * w * record.step)[:, None]).astype(complex)
    acting = z * (record.command * held + rest * (1.0 - stairs + stairs * held))
    return ActingTorque(acting, factor, z * (held - 1.0) * rest, by_hold)


def step_times(record: SpectralRecord, layout: Layout, p: Float64) -> Float64:
    """(M,) how much later than its samples the held torque of each axis steps [s]."""
    late = layout.lateness(p, record)
    if record.command is None:
        late = late - 0.5 * record.step  # the time offset holds the half sample by which holding is late
    late[list(layout.smoothed)] -= p[layout.smoothed_at]
    return late


def aliased_motion(record: SpectralRecord, layout: Layout, p: Float64, inertance: Float64) -> Complex128:
    """(F, M) displacement of the motors that the images of held torque fold onto the lines (``folding``).

    ``inertance`` (M, M) is the plant's at ``p``.
    """
    stairs = layout.stairs(p)
    late = layout.lateness(p, record)
    if record.command is None:
        stepped = stairs * record.torque
        late = late - 0.5 * record.step  # the time offset holds the half sample by which holding is late
    else:
        stepped = record.command + stairs * (record.torque - record.command)
    images = record.folding.at(late) * stepped
    result: Complex128 = images @ inertance
    return result


def prior_residuals(layout: Layout, p: Float64, effects: int) -> tuple[Float64, Float64]:
    """Prior: torque is held over the sample (1), continuous (0) or in between; so is that of a hold."""
    first, last = layout.stairs_at.start, layout.holds_at.stop
    expected = np.array([0.5] * len(layout.free_stairs) + [h.expected for h in layout.holds])
    rows = np.zeros((last - first, layout.count + effects))
    rows[:, first:last] = 2.0 * np.eye(last - first)
    return 2.0 * (p[first:last] - expected), rows
