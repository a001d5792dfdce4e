"""Free play in series with a spring."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace
from invid.effects.laws.sign import clip_law
from invid.effects.motion import View, rms
from invid.effects.parameter import Parameter
from invid.effects.sizes import ARCMIN, PLAY, PLAY_SOURCE, Size, size
from invid.model.parameters import ChainStructure
from invid.model.place import Place, spring_places
from invid.numerics.arrays import Complex128, Float64


def spring_index(structure: ChainStructure, place: Place) -> int:
    """Number of a spring among all springs."""
    return sum(n - 1 for n in structure.sizes[: place.axis]) + place.number - 1


def largest_deflection(views: Sequence[View], place: Place) -> float:
    """Largest deflection of a spring over all records."""
    return max(float(np.abs(v.wave(place.pattern(v.structure))).max()) for v in views)


class Backlash(Effect):
    """Spring and damper act on the part of the deflection beyond ±gap/2."""

    cause = "backlash"
    title = "free play in the transmission (backlash)"
    check = "Check the gear's wear, keys and couplings; measure the free play with the motor locked."
    separating = Experiment(
        "amplitudes", "a second amplitude: free play matters most when the motion is small"
    )
    family = "spring"
    looks_like = ("cubic_stiffness", "spring_hysteresis", "coulomb_friction")
    home = "spring"
    over = "deflection"
    sizes = (Size(PLAY, size("gap"), 1 * ARCMIN, 3 * ARCMIN, PLAY_SOURCE),)
    numbers = (Parameter("gap", "position", linear=False),)

    def places(self, structure: ChainStructure) -> list[Place]:
        return spring_places(structure)

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        size = max(rms([v.wave(place.pattern(v.structure)) for v in views]), 1e-300)
        return [(float(np.log(size * f)),) for f in np.geomspace(3e-4, 2.0, 16)]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        size = max(rms([v.wave(place.pattern(v.structure)) for v in views]), 1e-300)
        return [(float(np.log(1e-5 * size)), float(np.log(10 * size)))]

    def force(self, view: View, place: Place, gap: float) -> Complex128:
        """(F,) resistance beside the linear spring and damper: both lose the motion within the gap.

        A gap that the deflection crosses within a sample is seen through the mean over the sample.
        """
        at = spring_index(view.structure, place)
        inside = clip_law(view.wave(place.pattern(view.structure)), 0.5 * gap)
        lines = view.to_lines(inside[:, None], smeared=True)[:, 0]
        rate = 1j * view.omega * lines
        if view.record.transient:
            rate = rate + (inside[-1] - inside[0]) * 2.0 / view.record.span
            rate[0] *= 0.5
        out: Complex128 = -view.springs[at] * lines - view.dampers[at] * rate
        return out

    def contribution(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[Complex128, Complex128 | None]:
        pattern = place.pattern(view.structure)
        force = self.force(view, place, float(np.exp(x[0])))
        return view.condensed_force(pattern) * force[:, None], -view.inner_receptance(pattern) * force[
            :, None
        ]

    def beyond(self, views: Sequence[View], place: Place, x: Sequence[float]) -> bool:
        return bool(0.5 * np.exp(x[0]) >= largest_deflection(views, place))

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        out: Float64 = stiffness * (np.sign(x) * np.maximum(np.abs(x) - 0.5 * p["gap"], 0.0) - x)
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        a, b, stiffness, damping = at.spring()
        return [ForceLaw(Law.BACKLASH, a, b, (0.5 * abs(at.value("gap")), stiffness, damping))]
