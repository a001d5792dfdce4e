"""The load's mass changes during the recording."""

from __future__ import annotations

from collections.abc import Sequence

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, LaterMass, ModelPlace
from invid.effects.parameter import Parameter
from invid.effects.sizes import LOAD, RESONANCE, Size, load_change, resonance_change, with_load
from invid.model.place import end_places


class PayloadChange(Effect):
    """``mass`` added to the final mass from ``time`` on."""

    cause = "payload_change"
    title = "a load that changed during the measurement"
    check = "Check what was picked up, put down or came loose during the measurement."
    separating = Experiment("time", "repeat the first experiment at the end")
    family = "time"
    stands = (end_places,)
    looks_like = ("parameter_drift",)
    home = "end"
    sizes = (Size(LOAD, load_change), Size(RESONANCE, resonance_change(with_load)))
    numbers = (
        Parameter("mass", "mass"),
        Parameter("time", "time", linear=False, logarithmic=False),
    )

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [LaterMass(at.mass(at.last), at.value("mass"), at.value("time"))]
