"""A damper parallel to a spring. The linear model has one beside every spring already."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import AddedDamper, Element, ModelPlace
from invid.effects.parameter import Parameter
from invid.numerics.arrays import Float64


class SpringDamping(Effect):
    """Resistance coefficient·ḋ between the masses a spring joins."""

    cause = "spring_damping"
    title = "damping in the transmission"
    check = "Check the gear's grease and its elastomer parts."
    separating = Experiment("hand", "none needed: the linear fit contains it")
    family = "linear"
    # The damper beside every spring is fitted with the linear parameters: nothing is left to name.
    stands = ()
    home = "spring"
    over = "deflection rate"
    numbers = (Parameter("coefficient", "damping", low=0.0),)

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        return p["coefficient"] * x

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        a, b, _, _ = at.spring()
        return [AddedDamper(a, b, at.value("coefficient"))]
