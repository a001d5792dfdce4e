"""The load's mass changes during the recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Element, LaterMass, ModelPlace
from invid.effects.parameter import Parameter
from invid.effects.sizes import LOAD, RESONANCE, Size, load_change, resonance_change, with_load
from invid.effects.supposed.law import SMOOTH, Bounds, Shape, SpotMotion, SupposedLaw
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
    """A mass that comes on at a load at a time of the recording's clock; its shape is that time [s].

    The load has to be accelerated before that time and after it: a mass that is always there is the plant's.
    Where a record shows the mean of its periods it comes on before that record or after it.
    """

    effect, main = PayloadChange(), "mass"
    shape_step = 0.01
    MOST = 5.0
    WITHIN = (0.1, 0.3, 0.5, 0.7, 0.9)
    LEAST = 0.05
    """Share of the acceleration's power that lies before the change, and after it (physical)."""

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        late = (motion.time - shape[0]) / (motion.time[1] - motion.time[0])
        if motion.repeats:
            late = late[late.size // 2]
        force: Float64 = (motion.acceleration * np.clip(late + 0.5, 0.0, 1.0))[:, None]
        return force

    def shapes(self, motions: Sequence[SpotMotion]) -> list[Shape]:
        time, behind = _power_behind(motions)
        last = [int(np.searchsorted(behind, share)) for share in self.WITHIN]
        sound = sorted({k for k in last if k + 1 < time.size and behind[k] <= 1.0 - self.LEAST})
        return [(0.5 * float(time[k] + time[k + 1]),) for k in sound]

    def bounds(self, motions: Sequence[SpotMotion]) -> Bounds:
        time, behind = _power_behind(motions)
        first, last = np.searchsorted(behind, (self.LEAST, 1.0 - self.LEAST))
        return [(float(time[first]), float(time[last]))]

    def about(self, motions: Sequence[SpotMotion]) -> list[list[Shape]]:
        """A step's place tells its slope no farther than a few samples."""
        low, high = self.bounds(motions)[0]
        reach = max(high - low, self.shape_step)
        levels = range(max(1, int(np.ceil(np.log(reach / self.shape_step) / np.log(4.0)))))
        moves = np.linspace(-1.0, 1.0, 9)
        return [[(float(reach * 0.25**level * move),) for move in moves] for level in levels]

    def parameters(self, coefficients: Float64, shape: Shape, stiffness: float) -> dict[str, float]:
        return {"mass": float(coefficients[0]), "time": float(shape[0])}

    def limits(self, motions: Sequence[SpotMotion]) -> Bounds:
        """What goes is less than the load; what comes may be several times as much."""
        own = motions[0].own
        return super().limits(motions) if own is None else [(-0.9 * own, self.MOST * own)]


def _power_behind(motions: Sequence[SpotMotion]) -> tuple[Float64, Float64]:
    """Times (k,) of the recording's clock, and the share of the acceleration's power that lies behind each;
    of a record that shows a mean of periods all at its middle."""
    coarse = [m.every(SMOOTH) for m in motions]
    power = [m.acceleration**2 for m in coarse]
    clock = [np.full_like(m.time, m.time[m.time.size // 2]) if m.repeats else m.time for m in coarse]
    time, place = np.unique(np.concatenate(clock), return_inverse=True)
    behind = np.cumsum(np.bincount(place, np.concatenate(power)))
    return time, behind / max(float(behind[-1]), 1e-300)
