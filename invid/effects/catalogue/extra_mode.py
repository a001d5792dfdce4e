"""A mass on a spring that the model does not have."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import AddedMass, Element, ModelPlace
from invid.effects.sizes import RESONANCE, Size, resonance_change, with_mode
from invid.model.place import mass_places


class ExtraMode(Effect):
    """A mass m on a spring k (and a light damper) at one of the masses."""

    cause = "extra_mode"
    title = "a resonance that the model does not have"
    check = "Look for a flexible attachment: a tool, a cable carrier, a loose foot or cover."
    separating = Experiment("lines", "a finer and wider grid of frequencies around the resonance")
    family = "structure"
    stands = (mass_places,)
    looks_like = ("coupling_stiffness", "viscous_friction")
    home = "end"
    optional: ClassVar[Mapping[str, float]] = {"damping_ratio": 0.01}
    sizes = (Size(RESONANCE, resonance_change(with_mode)),)
    parameters: ClassVar[Mapping[str, str]] = {
        "mass": "mass",
        "stiffness": "stiffness",
        "damping_ratio": "ratio",
    }
    main = "mass"

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        ratio = at.optional("damping_ratio", self.optional["damping_ratio"])
        size = at.positive("mass"), at.positive("stiffness")
        return [AddedMass(at.mass(at.last), *size, max(ratio, 0.0))]
