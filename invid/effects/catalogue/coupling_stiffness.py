"""A spring between the loads of two axes: they are coupled by more than inertia."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import AddedSpring, Element, ModelPlace
from invid.effects.parameter import Parameter
from invid.effects.sizes import RESONANCE, Size, resonance_change, with_tie
from invid.errors import ModelError
from invid.model.place import pair_places
from invid.numerics.arrays import Float64


class CouplingStiffness(Effect):
    """A spring between the final masses of two axes."""

    cause = "coupling_stiffness"
    title = "an elastic coupling between two axes"
    check = "Look for a cable, hose, belt or common base that ties the two axes together."
    separating = Experiment("lines", "a slow move of one axis while the other is held")
    family = "structure"
    stands = (pair_places,)
    looks_like = ("extra_mode",)
    home = "axis"
    over = "deflection"
    sizes = (Size(RESONANCE, resonance_change(with_tie)),)
    numbers = (Parameter("stiffness", "stiffness", low=0.0),)

    def curve(self, p: Mapping[str, float], x: Float64, stiffness: float) -> Float64:
        return p["stiffness"] * x

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        other, axes = at.term.other_axis, at.chains.axes
        if other is None or other not in axes or other == at.term.axis:
            raise ModelError(
                f"effect coupling_stiffness on {at.term.axis}: other_axis is {other!r}; it must be another "
                f"of {list(axes)}"
            )
        ends = at.chains.end_dofs
        pair = int(ends[at.axis]), int(ends[axes.index(other)])
        return [AddedSpring(*pair, at.value("stiffness"))]
