"""Teeth that are not where they should be: the gear adds a sinusoid of position to the deflection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from invid.effects.catalogue.backlash import spring_index
from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, ForceLaw, Law, ModelPlace
from invid.effects.laws.ripple_cycles import cycle_grid, ripples, rotate_phase
from invid.effects.motion import View, rms
from invid.effects.sizes import ACCURACY_SOURCE, ARCMIN, GEAR_ERROR, Size, size
from invid.model.parameters import ChainStructure
from invid.model.place import Place, spring_places
from invid.numerics.arrays import Complex128, Float64


class TransmissionError(Effect):
    """The spring acts on d − e, e = amplitude·sin(cycles_per_rev·q + phase), q on its motor side.

    Without loss of energy the motor side feels it times 1 − ∂e/∂q.
    """

    cause = "transmission_error"
    title = "a position error of the gear (transmission error)"
    check = "Check the gear's teeth and its alignment; compensate over position."
    separating = Experiment("positions", "a slow move over a whole revolution, and a second amplitude")
    family = "position"
    looks_like = ("cogging", "encoder_eccentricity")
    home = "spring"
    over = "position"
    sizes = (Size(GEAR_ERROR, size("amplitude", 2.0), 1.5 * ARCMIN, 3 * ARCMIN, ACCURACY_SOURCE),)
    parameters: ClassVar[Mapping[str, str]] = {
        "amplitude": "position",
        "cycles_per_rev": "count",
        "phase": "angle",
    }
    coefficients = ("sine", "cosine")
    lower, upper = (-np.inf,) * 2, (np.inf,) * 2
    shapes, logarithmic = ("cycles_per_rev",), (True,)
    main = "amplitude"
    along_pattern = False  # the motor's side feels the slope of the error as well

    def places(self, structure: ChainStructure) -> list[Place]:
        return spring_places(structure)

    def follows_motor(self, place: Place) -> bool:
        return place.number == 1

    def _motor_side(self, view: View, place: Place) -> Float64:
        return view.wave((place.pattern(view.structure)[0],))

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        size = rms([self._motor_side(v, place) for v in views])
        pattern = place.pattern(views[0].structure)
        fast = ripples(views, (pattern[0],), pattern)
        return [(float(np.log(n)),) for n in cycle_grid(size, 8) + fast]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        return [(0.0, float(np.log(2000.0)))]

    def contribution(
        self, view: View, place: Place, x: Sequence[float]
    ) -> tuple[Complex128, Complex128 | None]:
        (a, _), (b, _) = place.pattern(view.structure)
        stiff = view.springs[spring_index(view.structure, place)]
        lines = stiff * view.to_lines(self.unit_forces(view, place, x)[0])
        out: Complex128 = np.zeros_like(view.acting)
        back: Complex128 = np.zeros_like(view.base)
        for at, force in ((a, lines[:, 0]), (b, lines[:, 1])):
            out = out + view.condensed_force(((at, 1.0),)) * force[:, None]
            back = back - view.inner_receptance(((at, 1.0),)) * force[:, None]
        return out, back

    def unit_forces(self, view: View, place: Place, x: Sequence[float]) -> tuple[Float64, Float64]:
        """(n, 2) resistance on the motor side and on the load side of a spring of stiffness one; and (n, 3)
        change of the first with the motor side's motion and with the deflection, of the second with the
        motor side's motion."""
        cycles = float(np.exp(x[2]))
        angle = cycles * self._motor_side(view, place)
        sine, cosine = np.sin(angle), np.cos(angle)
        error = x[0] * sine + x[1] * cosine
        slope = cycles * (x[0] * cosine - x[1] * sine)
        bent = cycles**2 * error  # less the slope's own slope
        d = view.wave(place.pattern(view.structure))
        near = (d - error) * (1.0 - slope) - d
        by_motor = (d - error) * bent - slope * (1.0 - slope)
        return np.stack([near, error], axis=1), np.stack([by_motor, -slope, slope], axis=1)

    def basis(self, view: View, place: Place, shape: Sequence[float]) -> Complex128:
        (a, _), (b, _) = place.pattern(view.structure)
        stiff = view.springs[spring_index(view.structure, place)]
        cycles = float(np.exp(shape[0]))
        angle = cycles * self._motor_side(view, place)
        sine, cosine = np.sin(angle), np.cos(angle)
        lean = cycles * view.wave(place.pattern(view.structure))
        waves = np.stack([-sine - lean * cosine, -cosine + lean * sine, sine, cosine], axis=1)
        lines = stiff * view.to_lines(waves)
        out: Complex128 = (
            view.condensed_force(((a, 1.0),))[:, :, None] * lines[:, None, :2]
            + view.condensed_force(((b, 1.0),))[:, :, None] * lines[:, None, 2:]
        )
        return out

    def beyond(self, views: Sequence[View], place: Place, x: Sequence[float]) -> bool:
        # The gear would turn back while its motor turns on; or be off by more than the motor ever turned: a
        # bend of the motion's own size is that of a spring (0.4 m on a travel of 0.09 m, for a cubic one).
        amplitude = float(np.hypot(x[0], x[1]))
        turned = max((float(np.abs(self._motor_side(v, place)).max()) for v in views), default=np.inf)
        return amplitude * float(np.exp(x[2])) >= 1.0 or amplitude > turned

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        return {
            "amplitude": float(np.hypot(x[0], x[1])),
            "cycles_per_rev": float(np.exp(x[2])),
            "phase": float(np.arctan2(x[1], x[0])),
        }

    def vector(self, p: Mapping[str, float]) -> list[float]:
        return [*rotate_phase(p["amplitude"], p["phase"]), float(np.log(p["cycles_per_rev"]))]

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        out: Float64 = -stiffness * p["amplitude"] * np.sin(p["cycles_per_rev"] * x + p["phase"])
        return out

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        a, b, stiffness, _ = at.spring()
        wave = at.value("amplitude"), at.value("cycles_per_rev"), at.value("phase")
        return [ForceLaw(Law.TRANSMISSION, a, b, (*wave, stiffness))]
