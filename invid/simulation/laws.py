"""Effects of a model as laws of the simulator of elastic machines.

What each cause is made of stands in its own file (``Effect.simulation``, ``invid.effects.elements``).
Signs: friction, damping, cogging, gravity and offset are resistances, so they enter with a minus.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from invid.effects.elements import (
    AddedBase,
    AddedDamper,
    AddedMass,
    AddedSpring,
    Drift,
    Element,
    ForceLaw,
    LaterMass,
    Law,
    ModelPlace,
    ReadingError,
    RepeatedRows,
    StaticLaw,
    TorqueChannel,
)
from invid.effects.registry import BY_CAUSE, law_of
from invid.errors import ModelError
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm
from invid.numerics.arrays import Float64

PARAMETERS = 6
TABLE_POINTS = 2049
"""Points of the table of a static law: straight between them, an error of 2·10⁻⁷ of the largest force for one
that grows with the square."""
SURFACE_POINTS = 257
"""The same along each of two quantities: 2·10⁻⁵."""


@dataclass(eq=False)
class Laws:
    """A model's effects, sorted by where the simulator treats them."""

    forces: list[ForceLaw] = field(default_factory=list)
    static: list[StaticLaw] = field(default_factory=list)
    stiffness: list[AddedSpring] = field(default_factory=list)
    damping: list[AddedDamper] = field(default_factory=list)
    extra_masses: list[AddedMass] = field(default_factory=list)
    bases: list[AddedBase] = field(default_factory=list)
    gain: dict[int, float] = field(default_factory=dict)
    delay: dict[int, float] = field(default_factory=dict)
    lag: dict[int, float] = field(default_factory=dict)
    limit: dict[int, float] = field(default_factory=dict)
    eccentricity: dict[int, list[tuple[float, float]]] = field(default_factory=dict)
    dropped: float = 0.0
    payloads: list[LaterMass] = field(default_factory=list)
    drifts: list[Drift] = field(default_factory=list)

    def add(self, element: Element, term: EffectTerm) -> None:
        """Sort in one element more."""
        match element:
            case ForceLaw():
                self.forces.append(element)
            case StaticLaw():
                self.static.append(element)
            case AddedSpring():
                self.stiffness.append(element)
            case AddedDamper():
                self.damping.append(element)
            case AddedMass():
                self.extra_masses.append(element)
            case AddedBase():
                self.bases.append(element)
            case TorqueChannel():
                self._channel_of(element)
            case ReadingError(axis, amplitude, phase):
                self.eccentricity.setdefault(axis, []).append((amplitude, phase))
            case RepeatedRows(fraction):
                if not 0 <= fraction < 1:
                    raise ModelError(
                        f"effect {term.cause} on {term.axis}: fraction is {fraction}; need 0 ≤ x < 1"
                    )
                self.dropped = 1.0 - (1.0 - self.dropped) * (1.0 - fraction)
            case LaterMass():
                self.payloads.append(element)
            case Drift():
                self.drifts.append(element)
            case _:
                raise ModelError(f"effect {term.cause} on {term.axis}: an elastic model has no place for it")

    def _channel_of(self, element: TorqueChannel) -> None:
        i = element.axis
        if element.gain != 1.0:
            self.gain[i] = self.gain.get(i, 1.0) * element.gain
        if element.delay:
            self.delay[i] = self.delay.get(i, 0.0) + element.delay
        if element.lag is not None:
            self.lag[i] = element.lag
        if element.limit is not None:
            self.limit[i] = element.limit


def laws_of(chains: CoupledChains, effects: tuple[EffectTerm, ...]) -> Laws:
    """All effects as laws; ModelError names the effect that cannot be simulated and why."""
    laws = Laws()
    for term in effects:
        for element in elements_of(chains, term):
            laws.add(element, term)
    return laws


def elements_of(chains: CoupledChains, term: EffectTerm, *, rigid: bool = False) -> Sequence[Element]:
    """Elements of an effect of a model; ModelError for an unknown cause or place."""
    effect = law_of(term)
    if effect is None:
        raise ModelError(
            f"effect {term.cause!r} on {term.axis} cannot be simulated; known: "
            f"{', '.join(sorted(BY_CAUSE))}; one from a file of its own needs that file (--effects FILE.py)"
        )
    return effect.simulation(ModelPlace(chains, term, rigid=rigid))


CompiledLaws = tuple[Float64, Float64, Float64, Float64, Float64]


def compiled_laws(forces: Sequence[ForceLaw], tables: Float64) -> CompiledLaws:
    """The kernel's ``laws``, at rest, with ``tables`` (S, P) of static ones."""
    kinds = np.array([[f.law, f.a, f.b] for f in forces], dtype=float).reshape(-1, 3)
    parameters = np.zeros((len(forces), PARAMETERS))
    for row, force in zip(parameters, forces, strict=True):
        row[: len(force.parameters)] = force.parameters
    return kinds, parameters, tables, np.zeros((len(forces), 3)), np.zeros(len(forces))


def static_table(
    laws: Sequence[StaticLaw], reach: Sequence[tuple[float, float]]
) -> tuple[list[ForceLaw], Float64]:
    """Static laws as laws of the kernel, and (S, P) their forces within ±reach of position and velocity.

    A law of both has SURFACE_POINTS² points, all velocities at the first position and so on.
    """
    points = SURFACE_POINTS**2 if any(law.over == "both" for law in laws) else TABLE_POINTS
    tables = np.zeros((max(len(laws), 1), points))
    out = []
    for row, (law, most) in enumerate(zip(laws, reach, strict=True)):
        if law.over == "both":
            grids = np.meshgrid(*(np.linspace(-m, m, SURFACE_POINTS) for m in most), indexing="ij")
            at = [g.ravel() for g in grids]
        else:
            largest = most[law.over == "velocity"]
            at = [np.linspace(-largest, largest, points)]
        values = np.asarray(law.force(*at), dtype=float)
        if values.shape != (points,) or not np.isfinite(values).all():
            over = "position and velocity" if law.over == "both" else law.over
            raise ModelError(
                f"simulation: a law over the {over} is not finite within ±{most[0]:.3g} and ±{most[1]:.3g} a "
                "second; check its numbers"
            )
        tables[row] = values
        kind = ("position", "velocity", "both").index(law.over)
        out.append(ForceLaw(Law.TABLE, law.a, law.b, (float(kind), *most, float(row))))
    return out, tables
