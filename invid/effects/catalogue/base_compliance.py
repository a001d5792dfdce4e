"""A base that gives way: all loads stand on one body, on a spring to ground.

With x the motion of the body and c = J s (``invid.effects.laws.moving_base``) the body's balance is
K x + D ẋ + M ẍ + cᵀq̈ = 0, M = m + sᵀJs its mass with all that stands on it, and load i feels −cᵢẍ. So
x = ω²cᵀq/(K + jωD − ω²M), and what resists the loads is one force along c,

    f = −ω² c x = −γ ω⁴ u (uᵀq) / (ω₀² + 2jζω₀ω − ω²),    γ = |c|²/M, u = c/|c|, ω₀² = K/M.

γ is linear in the force, u may be fitted without J, and only the parameters that are said need J: s = J⁻¹u,
scaled so that the load that takes most part moves as the body does (its share is one).

On one axis f is the resistance of a mass γ on a spring at the load, −γω²(ω₀² + 2jζω₀ω)/(ω₀² + 2jζω₀ω − ω²),
less that of the mass γ itself: no record of one motor tells a base from an ``extra_mode`` at its load.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import ClassVar

import numpy as np

from invid.effects.effect import Effect, Experiment
from invid.effects.elements import AddedBase, Element, ModelPlace
from invid.effects.laws.moving_base import SHARE, moved_by_base, shares_of
from invid.effects.sizes import RESONANCE, Size, resonance_change, with_base
from invid.model.document import EffectTerm
from invid.model.place import Place
from invid.model.plant import Structure


class BaseCompliance(Effect):
    """The body under all loads on a spring (and a light damper) to ground."""

    cause = "base_compliance"
    title = "a base that gives way under all axes"
    check = "Check the anchor bolts, the feet and the table or frame that the robot stands on."
    separating = Experiment(
        "lines", "one axis shaken while the others are held, on a finer grid of frequencies"
    )
    family = "structure"
    looks_like = ("extra_mode", "coupling_stiffness")
    home = "base"
    sizes = (Size(RESONANCE, resonance_change(with_base)),)
    main = "stiffness"
    parameters: ClassVar[Mapping[str, str]] = {
        "mass": "mass",
        "stiffness": "stiffness",
        "damping_ratio": "ratio",
    }
    optional: ClassVar[Mapping[str, float]] = {"damping_ratio": 0.01}

    def __init__(self, axes: int = 1) -> None:
        """The law on a machine of ``axes``."""
        if axes > 1:
            shares = {f"{SHARE}{i + 1}": "ratio" for i in range(axes)}
            kept = BaseCompliance.parameters, BaseCompliance.optional
            self.parameters = {**kept[0], **shares}  # type: ignore[misc]
            self.optional = {**kept[1], **dict.fromkeys(shares, 1.0)}  # type: ignore[misc]

    def places(self, structure: Structure) -> list[Place]:
        return [Place("base", 0)]

    def known(self, term: EffectTerm) -> BaseCompliance:
        count = sum(name.startswith(SHARE) for name in term.parameters)
        return _law_of(max(count, 1))

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        chains = at.chains
        inertia = chains.end_mass_matrix
        p = {name: e.value for name, e in at.term.parameters.items()}
        p |= {"mass": at.positive("mass"), "stiffness": at.positive("stiffness")}
        total, force = moved_by_base(p, inertia)
        ratio = max(at.optional("damping_ratio", self.optional["damping_ratio"]), 0.0)
        damper = 2.0 * ratio * float(np.sqrt(total * p["stiffness"]))
        shares = shares_of(p, chains.branches)
        return [AddedBase(total, p["stiffness"], damper, tuple(force.tolist()), tuple(shares.tolist()))]


@cache
def _law_of(axes: int) -> BaseCompliance:
    """The law on a machine of so many axes, one and the same each time."""
    return BaseCompliance(axes)
