"""The torque that acts is cut off at a limit that the record does not show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ModelPlace, TorqueChannel
from invid.effects.motion import View
from invid.effects.parameter import Parameter
from invid.effects.sizes import RATED_SOURCE, SHORTFALL, Size, shortfall
from invid.model.parameters import ChainStructure
from invid.model.place import Place, axis_places
from invid.numerics.arrays import Complex128, Float64

LIMITS_TRIED = (0.3, 0.4, 0.5, 0.6, 0.7, 0.78, 0.85, 0.9, 0.94, 0.97, 0.985, 0.992)
"""Limits to start from over the peak torque. The clipped part halves from one to the next at the top: a limit
that clips more than twice of what is missing makes the fit worse, and would not be found."""

PARTS_OF_SAMPLE = 4
"""Parts of a sample where a hold changes within it."""


class TorqueSaturation(Effect):
    """Acting torque = recorded torque within ±limit."""

    cause = "torque_saturation"
    title = "torque that is cut off at a limit"
    check = "Check the drive's current and torque limits and its bus voltage."
    separating = Experiment("amplitudes", "a second amplitude: below the limit nothing is missing")
    family = "saturation"
    looks_like = ("torque_gain",)
    home = "axis"
    over = "torque"
    sizes = (Size(SHORTFALL, shortfall, 0.0, 0.0, RATED_SOURCE, linear=True),)
    numbers = (Parameter("limit", "torque", linear=False),)

    def places(self, structure: ChainStructure) -> list[Place]:
        return axis_places(structure)

    def _peak_torque(self, views: Sequence[View], place: Place) -> float:
        return max(float(np.abs(v.record.torque_wave[:, place.axis]).max()) for v in views)

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        peak = max(self._peak_torque(views, place), 1e-300)
        return [(float(np.log(peak * f)),) for f in LIMITS_TRIED]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        peak = max(self._peak_torque(views, place), 1e-300)
        # Cut below a tenth of its peak a torque is no measurement of itself any more, and the fit could
        # shrink plant and torque together until noise covers both.
        return [(float(np.log(0.1 * peak)), float(np.log(0.995 * peak)))]

    def contribution(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[Complex128, Complex128 | None]:
        limit = float(np.exp(x[0]))
        t = view.record.torque_wave[:, place.axis]
        recorded = view.record.torque[:, place.axis]
        if view.record.command is None:
            cut = view.to_lines(_clipped_part(t, limit)[:, None])[:, 0]
        else:
            cut, recorded = _clipped_within_samples(view, place.axis, limit)
        out: Complex128 = np.zeros_like(view.acting)
        there = np.abs(recorded) > 0
        ratio = np.where(there, view.acting[:, place.axis] / np.where(there, recorded, 1.0), 1.0)
        out[:, place.axis] = cut * ratio
        return out, None

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        out: Float64 = x - np.clip(x, -p["limit"], p["limit"])
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [TorqueChannel(at.axis, limit=abs(at.value("limit")))]


def _clipped_part(torque: Float64, limit: float) -> Float64:
    return torque - np.clip(torque, -limit, limit)


def _clipped_within_samples(view: View, axis: int, limit: float) -> tuple[Complex128, Complex128]:
    """(F,) clipped part of a demand held over each sample and a hold that changes within it, and their sum.

    At the samples alone the hold has the value at which the demand changed.
    """
    record, wave = view.record, view.record.torque_wave[:, axis]
    command = np.zeros(0, dtype=complex) if record.command is None else record.command[:, axis]
    half = np.zeros(wave.size // 2 + 1, dtype=complex)
    half[record.lines] = command * (wave.size / 2)
    half[0] *= 2.0
    demand = np.fft.irfft(half, wave.size)
    hold = wave - demand
    change = np.append(np.diff(hold), 0.0 if record.transient else hold[0] - hold[-1])
    cut: Complex128 = np.zeros(view.omega.size, dtype=complex)
    for part in (np.arange(PARTS_OF_SAMPLE) + 0.5) / PARTS_OF_SAMPLE:
        lines = view.to_lines(_clipped_part(demand + hold + part * change, limit)[:, None])[:, 0]
        cut += lines * np.exp(-1j * view.omega * part * record.step) / PARTS_OF_SAMPLE
    late = np.sinc(view.omega * record.step / 2 / np.pi) * np.exp(-0.5j * view.omega * record.step)
    return cut, command * late + record.torque[:, axis] - command
