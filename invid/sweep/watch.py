"""Watch every cycle, on excited and on held axes alike."""

from __future__ import annotations

from collections.abc import Collection
from itertools import pairwise

from invid.errors import SafetyStop
from invid.sweep.bounds import Bounds
from invid.sweep.drive_word import DriveWords
from invid.sweep.ports import Sample
from invid.sweep.stuck_encoder import UNMOVED_COUNTS, Halting
from invid.wording.sentence import sentence

STAND_S, STAND_PERIODS = 1.5, 0.25
"""An encoder that stands so long under shaking is dead, and never sooner than after a quarter period of the
slowest line. A mass under a sinusoidal torque of amplitude A with Coulomb friction F stops where
A·(cos φ₀ − cos φ) = F·(φ − φ₀), sin φ₀ = F/A, and breaks loose at π + φ₀: it stands for a quarter period at
F = 0.87·A, and from there on friction has nearly won. Sooner torque tells that must have moved the axis."""
ENERGY_WINDOW_S = 0.25
ENERGY_GROWTH = 1.25
ENERGY_WINDOWS = 4
ENERGY_SHARE = 0.0025
"""An unstable hold: the held axes' Σ(v/v_limit)² grows by a quarter in each of four windows of 0.25 s
and has passed 5 % of the velocity limit (0.0025 = 0.05²). A linear structure driven at constant
amplitude stops growing; 1.25⁴ = 2.4 in a second is faster than any mode in a robot rings up and slower
than the growth of the unstable P holds measured on the case study (0.78 /s at K_R = 1000 is 4.8 in
energy). Empirical."""


class Watch:
    """Checks one sample after another; raises on the first that must stop the motion."""

    def __init__(self, bounds: Bounds, *, cycle_s: float) -> None:
        """``bounds``: the cell looks at them, and at what its drives are in, in every cycle."""
        self.bounds, self._cycle = bounds, cycle_s
        self._energy = 0.0
        self._energy_cycles = 0
        self._energies: list[float] = []
        self._stands: dict[int, tuple[float, float] | None] = {}
        self._longest_s = STAND_S
        limits = bounds.limits
        names = [a.name for a in limits]
        self.words = DriveWords(names, cycle_s)
        self.halting = Halting(names, [a.resolution for a in limits], limits[0].unit, cycle_s)
        self.held: set[int] = set()
        """Axes whose energy is watched for growth."""

    def settle(self) -> None:
        """Judge growth of energy afresh, as the excitation changed."""
        self._energies.clear()
        self._energy, self._energy_cycles = 0.0, 0

    def expect_motion(self, axes: Collection[int], lowest_hz: float = 0.0) -> None:
        """From here on these axes are shaken, by lines from ``lowest_hz`` on, with what must move them."""
        self._stands = dict.fromkeys(axes)
        self._longest_s = max(STAND_S, STAND_PERIODS / lowest_hz) if lowest_hz > 0 else STAND_S

    def check(self, sample: Sample) -> None:
        """Raise SafetyStop where the motion must stop."""
        bounds = self.bounds
        if bounds.origin is None:
            return
        energy = 0.0
        for i, limit in enumerate(bounds.limits):
            if not sample.fresh[i]:
                continue
            if bounds.speeds[i] > 0 and i in self.held:
                energy += (bounds.speeds[i] / limit.velocity) ** 2
        self._watch_energy(energy)
        self.words.check(sample)
        try:
            self.halting.check(sample)
            self._check_motion(sample)
        except SafetyStop as error:
            bounds.blind = {i for i, limit in enumerate(bounds.limits) if limit.name == error.axis}
            raise

    def _check_motion(self, sample: Sample) -> None:
        for i, stand in self._stands.items():
            limit, place = self.bounds.limits[i], sample.position[i]
            if stand is None or abs(place - stand[0]) > UNMOVED_COUNTS * abs(limit.resolution):
                self._stands[i] = (place, sample.time) if sample.fresh[i] else None
            elif sample.time - stand[1] > self._longest_s:
                raise SafetyStop(
                    sentence(
                        "axis {axis}: the encoder has shown one value for {longest_s:.2g} s of shaking",
                        axis=limit.name,
                        longest_s=self._longest_s,
                    ),
                    way_out="the encoder is stuck, the brake is closed, or friction is above the torque",
                    code="stands",
                    axis=limit.name,
                )

    def _watch_energy(self, energy: float) -> None:
        self._energy += energy
        self._energy_cycles += 1
        if self._energy_cycles * self._cycle < ENERGY_WINDOW_S:
            return
        mean = self._energy / self._energy_cycles
        self._energy, self._energy_cycles = 0.0, 0
        seen = self._energies
        seen.append(mean)
        if len(seen) > ENERGY_WINDOWS + 1:
            del seen[0]
        if len(seen) <= ENERGY_WINDOWS or seen[-1] <= ENERGY_SHARE:
            return
        if all(after > ENERGY_GROWTH * before for before, after in pairwise(seen)):
            names = ", ".join(self.bounds.limits[i].name for i in sorted(self.held))
            raise SafetyStop(
                sentence(
                    "the motion of the held axes ({names}) keeps growing: a hold is unstable", names=names
                ),
                way_out="use hold mode 'drive', or master_pd with a lower gain",
                code="hold_unstable",
                axis=self.bounds.limits[min(self.held)].name if len(self.held) == 1 else None,
            )
