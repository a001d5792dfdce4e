"""A stiffness that drifts with time: warming up, fatigue, a loosening joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import Drift, Element, ModelPlace
from invid.effects.sizes import DRIFTED, RESONANCE, Size, drift, resonance_change, with_drift
from invid.effects.supposed.law import SMOOTH, Bounds, Shape, SpotMotion, SupposedLaw
from invid.model.place import spring_places
from invid.numerics.arrays import Float64


class ParameterDrift(Effect):
    """Stiffness of a spring changes by ``rate`` a second, from the start of the recording."""

    cause = "parameter_drift"
    title = "a stiffness that drifts with time"
    check = "Check warming up, loosening joints and wear; repeat when the machine is warm."
    separating = Experiment(
        "time", "repeat the first experiment at the end, and once more when the machine is warm"
    )
    family = "time"
    stands = (spring_places,)
    looks_like = ("payload_change",)
    home = "spring"
    sizes = (Size(DRIFTED, drift), Size(RESONANCE, resonance_change(with_drift)))
    parameters: ClassVar[Mapping[str, str]] = {"parameter": "count", "rate": "stiffness_rate"}
    main = "rate"

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        if (at.term.element or "spring 1").startswith("mass"):
            return [Drift(at.mass(), -1, at.value("rate"))]
        a, b, _, _ = at.spring()
        return [Drift(a, b, at.value("rate"))]


class ParameterDriftLaw(SupposedLaw):
    """A spring's stiffness that changes by its coefficient a second, from the start of the recording on."""

    effect, main, counts = ParameterDrift(), "rate", "parameter"

    def stride(self, motion: SpotMotion, shape: Shape) -> int:
        return SMOOTH

    def waves(self, motion: SpotMotion, shape: Shape) -> Float64:
        force: Float64 = (motion.position * (motion.time - motion.origin))[:, None]
        return force

    def limits(self, motions: Sequence[SpotMotion]) -> Bounds:
        """A spring that drifts by more than itself stands for another one."""
        own = motions[0].own
        if own is None:
            return super().limits(motions)
        most = own / max(float(m.time[-1] - m.origin) for m in motions)
        return [(-most, most)]
