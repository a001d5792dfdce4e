"""Axes that get faster against all the torque that they may have: a wrong sign, or somebody pushes."""

from __future__ import annotations

from collections.abc import Collection

from invid.errors import SafetyStop
from invid.sweep.ports import Sample

AT_LIMIT = 0.95
"""Share of the torque limit that counts as all of it, with the noise of 0x6077."""
YIELD_S = 0.02
"""It must last so long. In a healthy run no feedback reaches the limit at all."""
FASTER, SPEED_SHARE = 1.2, 0.05
"""Speed over that at which the limit was reached, beyond this share of the speed limit: what brakes with all
its torque slows down. A spring may pull as hard for a moment, but it does not hold out (empirical)."""


class Yielding:
    """Speed of each axis since its torque came to the limit against its motion."""

    def __init__(self, names: list[str], torque: list[float], velocity: list[float], unit: str) -> None:
        """``torque``, ``velocity``: limits of each axis."""
        self._names, self._torque, self._velocity, self._unit = names, torque, velocity, unit
        count = len(names)
        self._last: list[tuple[float, float] | None] = [None] * count
        self._since: list[tuple[float, float] | None] = [None] * count

    def check(self, sample: Sample, led: Collection[int]) -> None:
        """SafetyStop where an axis yields whose loop the master closes (``led``)."""
        for i, fresh in enumerate(sample.fresh):
            if not fresh:
                continue
            last, position = self._last[i], sample.position[i]
            self._last[i] = sample.time, position
            if last is None or sample.time <= last[0]:
                continue
            speed = (position - last[1]) / (sample.time - last[0])
            torque = sample.torque[i]
            if abs(torque) < AT_LIMIT * self._torque[i] or torque * speed >= 0.0 or i not in led:
                self._since[i] = None
                continue
            since = self._since[i]
            if since is None:
                self._since[i] = sample.time, abs(speed)
                continue
            fast = FASTER * since[1] + SPEED_SHARE * self._velocity[i]
            if sample.time - since[0] >= YIELD_S and abs(speed) > fast:
                raise SafetyStop(
                    f"axis {self._names[i]}: gets faster against the torque limit: {abs(speed):.3g} "
                    f"{self._unit}/s, {since[1]:.3g} {1e3 * (sample.time - since[0]):.0f} ms before",
                    way_out="somebody pushes it, or a sign is wrong in the drive",
                    code="yields",
                    axis=self._names[i],
                )
