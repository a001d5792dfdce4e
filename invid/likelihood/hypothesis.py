"""The parameter vector of a joint fit, and the acting torque: timing, zero-order hold, position holds."""

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
    """The parameter vector (n,): structure, time offset of each axis, share held over the sample of each
    axis, share of each hold that works inside its drive, time constant of each drive that smooths reported
    torque."""

    structure: ChainStructure
    step: float
    free_zoh: tuple[int, ...]
    known_zoh: Float64
    free_delays: tuple[int, ...]
    origin: float
    delayed: tuple[int, ...] = ()
    """Axes whose delay belongs to an effect."""
    holds: tuple[InsideHold, ...] = ()
    smoothed: tuple[int, ...] = ()
    """Axes whose recorded torque is low-passed, by the identification."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        axes = self.structure.axes
        return (
            *self.structure.names,
            *(f"{axes[i]}.time_offset" for i in self.free_delays),
            *(f"{axes[i]}.held_over_sample" for i in self.free_zoh),
            *(f"{axes[h.axis]}.{h.name}" for h in self.holds),
            *(f"{axes[i]}.torque_smoothed" for i in self.smoothed),
        )

    @property
    def count(self) -> int:
        """Number of parameters n."""
        return int(self.lag_slice.stop)

    @property
    def zoh_slice(self) -> slice:
        """Slice of the shares held over the sample."""
        first = self.structure.count + len(self.free_delays)
        return slice(first, first + len(self.free_zoh))

    @property
    def hold_slice(self) -> slice:
        """Slice of the shares of the holds."""
        return slice(self.zoh_slice.stop, self.zoh_slice.stop + len(self.holds))

    @property
    def lag_slice(self) -> slice:
        """Slice of the time constants of reported torque."""
        return slice(self.hold_slice.stop, self.hold_slice.stop + len(self.smoothed))

    def inverse_lag(self, p: Float64, omega: Float64) -> Complex128:
        """(F, M) ratio of the torque to the one reported through a first-order lag."""
        out = np.ones((omega.size, self.structure.motors), dtype=complex)
        out[:, list(self.smoothed)] += 1j * omega[:, None] * p[self.lag_slice]
        return out

    def delays(self, p: Float64) -> Float64:
        """(M,) time offsets [s]."""
        out = np.zeros(self.structure.motors)
        at = self.structure.count
        out[list(self.free_delays)] = p[at : at + len(self.free_delays)]
        return out

    @property
    def late_zoh_axes(self) -> tuple[int, ...]:
        """Axes with the delay of an effect whose measured torque may be held over its sample.

        Holding delays by half a sample, which a free time offset absorbs; beside a delay that belongs to an
        effect it has to be counted, or the effect would be half a sample too long. Where the torque is the
        recorded demand itself, the effect is its total delay, holding included.
        """
        return tuple(i for i in self.delayed if i in self.free_zoh)

    def total_delay(self, p: Float64, record: SpectralRecord) -> Float64:
        """(M,) delay [s] of the acting torque against the recorded one, effects not counted."""
        out = self.delays(p)
        if (
            self.late_zoh_axes and record.command is None
        ):  # a demand beside a hold has its half sample of its own
            at = list(self.late_zoh_axes)
            out[at] += 0.5 * self.step * self.zoh_share(p)[at]
        return out

    def zoh_share(self, p: Float64) -> Float64:
        """(M,) share of the torque that is held over each sample (zero-order hold)."""
        out = self.known_zoh.copy()
        out[list(self.free_zoh)] = p[self.zoh_slice]
        return out

    def without_delay(self, axes: Sequence[int]) -> tuple[Layout, Bool]:
        """The layout with the delays of some axes left to effects, and (n,) which parameters remain."""
        kept = tuple(i for i in self.free_delays if i not in axes)
        kept_parameters = np.ones(self.count, dtype=bool)
        for k, i in enumerate(self.free_delays):
            if i in axes:
                kept_parameters[self.structure.count + k] = False
        delayed = tuple(sorted({*self.delayed, *axes}))
        return replace(self, free_delays=kept, delayed=delayed), kept_parameters

    def with_delay(self, axis: int) -> Layout:
        """The layout with the time offset of an axis free again."""
        free = tuple(sorted((*self.free_delays, axis)))
        return replace(self, free_delays=free, delayed=tuple(i for i in self.delayed if i != axis))


@dataclass(frozen=True, eq=False)
class ActingTorque:
    """The acting torque in a record, and its derivatives."""

    torque: Complex128
    """(F, M)."""
    factor: Complex128
    """(F, M) what recorded torque is multiplied by."""
    by_zoh_share: Complex128
    """(F, M) its derivative by the share held over the sample."""
    by_hold: Complex128
    """(F, holds) its derivative by each hold's share."""


def acting_torque(record: SpectralRecord, layout: Layout, p: Float64) -> ActingTorque:
    """The acting torque of a record at ``p`` (n,).

    A zero-order hold reduces the amplitude and delays by half a sample. The time offset absorbs the delay
    where all torque is alike. Where the demand is logged beside a hold, the demand is held over the sample
    (the contract says so) and ``zoh_share`` is the share of the rest that is.
    """
    w = record.omega
    delays, share_held = layout.total_delay(p, record), layout.zoh_share(p)
    loss = record.folding.zoh_loss[:, None]
    z = np.exp(-1j * w[:, None] * delays) * layout.inverse_lag(p, w)
    factor = z * (1.0 - share_held * loss)
    by_hold = np.zeros((w.size, len(layout.holds)), dtype=complex)
    if record.command is None:
        acting = factor * record.torque
        by_stair = -z * loss * record.torque
        for k, (hold, share) in enumerate(zip(layout.holds, p[layout.hold_slice], strict=True)):
            i = hold.axis
            if record.key not in hold.records:
                continue
            # Command E = T + HΘ and hold −HΘ act at different times: A·T + (A − z₂)·H·Θ, z₂ half a sample
            # earlier and without the zero-order hold.
            torque = hold.law(w) * record.position[:, i]
            by_hold[:, k] = (factor[:, i] - z[:, i] * np.exp(0.5j * w * record.step)) * torque
            acting[:, i] += share * by_hold[:, k]
            by_stair[:, i] -= share * (z * loss)[:, i] * torque
        return ActingTorque(acting, factor, by_stair, by_hold)
    rest = record.torque - record.command
    held = ((1.0 - loss) * np.exp(-0.5j * w * record.step)[:, None]).astype(complex)
    acting = z * (record.command * held + rest * (1.0 - share_held + share_held * held))
    return ActingTorque(acting, factor, z * (held - 1.0) * rest, by_hold)


def step_times(record: SpectralRecord, layout: Layout, p: Float64) -> Float64:
    """(M,) how much later than its samples the held torque of each axis steps [s]."""
    late = layout.total_delay(p, record)
    if record.command is None:
        late = late - 0.5 * record.step  # the time offset holds the half sample by which holding is late
    late[list(layout.smoothed)] -= p[layout.lag_slice]
    return late


def aliased_motion(record: SpectralRecord, layout: Layout, p: Float64, inertance: Float64) -> Complex128:
    """(F, M) displacement of the motors that the images of held torque alias onto the lines (``folding``).

    ``inertance`` (M, M) is the plant's at ``p``.
    """
    share_held = layout.zoh_share(p)
    delay = layout.total_delay(p, record)
    if record.command is None:
        stepped = share_held * record.torque
        delay = delay - 0.5 * record.step  # the time offset holds the half sample by which holding is late
    else:
        stepped = record.command + share_held * (record.torque - record.command)
    images = record.folding.at(delay) * stepped
    result: Complex128 = images @ inertance
    return result


def prior_residuals(layout: Layout, p: Float64, effects: int) -> tuple[Float64, Float64]:
    """Residual and rows of the prior: torque is held over the sample (1), continuous (0) or between; so is a
    hold's."""
    first, last = layout.zoh_slice.start, layout.hold_slice.stop
    expected = np.array([0.5] * len(layout.free_zoh) + [h.expected for h in layout.holds])
    rows = np.zeros((last - first, layout.count + effects))
    rows[:, first:last] = 2.0 * np.eye(last - first)
    return 2.0 * (p[first:last] - expected), rows
