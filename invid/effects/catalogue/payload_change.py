"""The load's mass changes during the recording."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from invid.effects.effect import Experiment, ImpedanceEffect
from invid.effects.elements import Element, LaterMass, ModelPlace
from invid.effects.motion import View
from invid.effects.parameter import Parameter
from invid.effects.sizes import LOAD, RESONANCE, Size, load_change, resonance_change, with_load
from invid.model.parameters import ChainStructure
from invid.model.place import Place, end_places
from invid.numerics.arrays import Complex128


class PayloadChange(ImpedanceEffect):
    """``mass`` added to the final mass from ``time`` on."""

    cause = "payload_change"
    title = "a load that changed during the measurement"
    check = "Check what was picked up, put down or came loose during the measurement."
    separating = Experiment("time", "repeat the first experiment at the end")
    family = "time"
    looks_like = ("parameter_drift",)
    home = "end"
    sizes = (Size(LOAD, load_change), Size(RESONANCE, resonance_change(with_load)))
    numbers = (
        Parameter("mass", "mass"),
        Parameter("time", "time", linear=False, logarithmic=False),
    )

    def places(self, structure: ChainStructure) -> list[Place]:
        return end_places(structure)

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        spans = sorted({(v.record.start_time, v.record.end_time) for v in views})
        times = [0.5 * (a[1] + b[0]) for a, b in pairwise(spans)]
        return [(float(t),) for t in sorted(times)]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        return [(min(v.record.start_time for v in views), max(v.record.end_time for v in views))]

    def difference(self, view: View, shape: int, value: float) -> float:
        # Not of the time itself: it may count from 1970.
        return 1e-4 * (view.record.end_time - view.record.start_time)

    def impedance(self, view: View, place: Place, x: Sequence[float]) -> Complex128:
        out: Complex128 = (-(view.omega**2) * x[0] * view.record.after(float(x[1]))).astype(complex)
        return out

    def carries(self, view: View, x: Sequence[float]) -> tuple[float, float]:
        return float(x[0]) * view.record.after(float(x[1])), 0.0

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [LaterMass(at.mass(at.last), at.value("mass"), at.value("time"))]
