"""The load's mass changes during the recording."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, LaterMass, ModelPlace
from invid.effects.parameter import Parameter
from invid.effects.sizes import LOAD, RESONANCE, Size, load_change, resonance_change, with_load
from invid.effects.supposed.law import Bounds, Shape, SpotMotion, SupposedLaw
from invid.model.place import end_places
from invid.numerics.arrays import Float64


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
    numbers = (Parameter("mass", "mass"), Parameter("time", "time", linear=False, logarithmic=False))

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        return [LaterMass(at.mass(at.last), at.value("mass"), at.value("time"))]


class PayloadChangeLaw(SupposedLaw):
    """A mass that comes on at a load at a time of the recording's clock; its shape is that time [s]."""

    effect, main = PayloadChange(), "mass"
    shape_step = 0.01
    MOST = 5.0
    WITHIN = (0.1, 0.3, 0.5, 0.7, 0.9)

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        late = (motion.time - shape[0]) / (motion.time[1] - motion.time[0])
        force: Float64 = (motion.acceleration * np.clip(late + 0.5, 0.0, 1.0))[:, None]
        return force

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        spans = _spans(motions)
        between = [0.5 * (a[1] + b[0]) for a, b in pairwise(spans) if b[0] > a[1]]
        within = [first + share * (last - first) for first, last in spans for share in self.WITHIN]
        return [(time,) for time in sorted(between + within)]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        spans = _spans(motions)
        margin = 0.02 * (spans[0][1] - spans[0][0])
        return [(spans[0][0] + margin, max(last for _, last in spans) - margin)]

    def about(self, motions: Sequence[SpotMotion]) -> list[list[Shape]]:
        """A step's place tells its slope no farther than a few samples."""
        first, last = _spans(motions)[0]
        reach = (self.WITHIN[1] - self.WITHIN[0]) * (last - first)
        levels = range(max(1, int(np.ceil(np.log(reach / self.shape_step) / np.log(4.0)))))
        moves = np.linspace(-1.0, 1.0, 9)
        return [[(float(reach * 0.25**level * move),) for move in moves] for level in levels]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"mass": float(coefficients[0]), "time": float(shape[0])}

    def limits(self, motions: Sequence[SpotMotion]) -> Bounds:
        """What goes is less than the load; what comes may be several times as much."""
        own = motions[0].own
        return super().limits(motions) if own is None else [(-0.9 * own, self.MOST * own)]


def _spans(motions: Sequence[SpotMotion]) -> list[tuple[float, float]]:
    return sorted({(float(m.time[0]), float(m.time[-1])) for m in motions})
