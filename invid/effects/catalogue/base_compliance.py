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

from invid.effects.catalogue.extra_mode import MOST_BEYOND_BAND, excited_band, frequency_grid
from invid.effects.effect import Experiment, ImpedanceEffect
from invid.effects.elements import AddedBase, Element, ModelPlace
from invid.effects.laws.moving_base import (
    SHARE,
    angles_of,
    load_inertia,
    moved_by_base,
    shares_of,
    unit_direction,
)
from invid.effects.motion import View, along
from invid.effects.sizes import RESONANCE, Size, resonance_change, with_base
from invid.model.chains import CoupledChains
from invid.model.document import EffectTerm
from invid.model.parameters import ChainStructure
from invid.model.place import Pattern, Place
from invid.numerics.arrays import Complex128, Float64

HEAVIEST = 1000.0
"""Most mass of the body over that of its heaviest load: what moves a thousandth as far as its load is no base
that gives way (physical)."""
LEAST_FREE = 1e-6
"""Least mass of the body over that with its loads: below, the loads alone are more than what moves
(physical)."""


class BaseCompliance(ImpedanceEffect):
    """The body under all loads on a spring (and a light damper) to ground; shapes: frequency, damping and
    direction."""

    cause = "base_compliance"
    title = "a base that gives way under all axes"
    check = "Check the anchor bolts, the feet and the table or frame that the robot stands on."
    separating = Experiment(
        "lines", "one axis shaken while the others are held, on a finer grid of frequencies"
    )
    family = "structure"
    looks_like = ("extra_mode", "coupling_stiffness")
    home = "base"
    least_axes = 2  # on one axis it stands beside each extra mode as its alternative
    sizes = (Size(RESONANCE, resonance_change(with_base)),)
    coefficients = ("coupled_mass",)
    lower, upper = (0.0,), (np.inf,)
    main = "stiffness"
    along_pattern = False
    parameters: ClassVar[Mapping[str, str]] = {
        "mass": "mass",
        "stiffness": "stiffness",
        "damping_ratio": "ratio",
    }
    optional: ClassVar[Mapping[str, float]] = {"damping_ratio": 0.01}
    shapes: tuple[str, ...] = ("frequency", "damping")
    logarithmic: tuple[bool, ...] = (True, True)

    def __init__(self, axes: int = 1, inertia: Float64 | None = None) -> None:
        """The law on a machine of ``axes``; ``inertia`` (M, M) of its loads, that of a unit mass where not
        known."""
        self._axes = axes
        self._inertia = np.eye(axes) if inertia is None else inertia
        if axes > 1:
            shares = {f"{SHARE}{i + 1}": "ratio" for i in range(axes)}
            kept = BaseCompliance.parameters, BaseCompliance.optional
            self.parameters = {**kept[0], **shares}  # type: ignore[misc]
            self.optional = {**kept[1], **dict.fromkeys(shares, 1.0)}  # type: ignore[misc]
            self.shapes = (*BaseCompliance.shapes, *(f"angle_{i + 1}" for i in range(axes - 1)))
            self.logarithmic = (True, True, *(False for _ in range(axes - 1)))

    def of_structure(self, structure: ChainStructure) -> BaseCompliance:
        return _law_of(structure.motors)

    def of_machine(self, chains: CoupledChains) -> BaseCompliance:
        return BaseCompliance(chains.branches, load_inertia(chains))

    def places(self, structure: ChainStructure) -> list[Place]:
        return [Place("base", 0)]

    def most_places(self, structure: ChainStructure) -> int:
        return 1

    def pattern(self, structure: ChainStructure, place: Place, x: Sequence[float]) -> Pattern:
        angles = np.asarray(x[3:], dtype=float)
        if angles.size != structure.motors - 1:
            return place.pattern(structure)
        weights = unit_direction(angles)
        return tuple((int(at), float(u)) for at, u in zip(structure.end_dofs, weights, strict=True))

    def grid(self, views: Sequence[View], place: Place) -> list[tuple[float, ...]]:
        patterns = tuple(((int(at), 1.0),) for at in views[0].structure.end_dofs)
        lines = frequency_grid(views, patterns)
        directions = [tuple(angles_of(d)) for d in _directions(_inertia_in(views[0]))]
        return [(float(np.log(w)), float(np.log(0.02)), *d) for w in lines for d in directions]

    def limits(self, views: Sequence[View], place: Place) -> list[tuple[float, float]]:
        low, high = excited_band(views)
        return [
            (float(np.log(low)), float(np.log(MOST_BEYOND_BAND * high))),
            (float(np.log(1e-3)), float(np.log(0.2))),
            *[(-np.inf, np.inf)] * (self._axes - 1),
        ]

    def difference(self, view: View, shape: int, value: float) -> float:
        return 1e-4  # logarithms and angles alike

    def impedance(self, view: View, place: Place, x: Sequence[float]) -> Complex128:
        _, below = _spring_and_rest(view.omega, x)
        out: Complex128 = -x[0] * view.omega**4 / below
        return out

    def carries(self, view: View, x: Sequence[float]) -> tuple[Complex128, float]:
        # The loads' accelerations drive the body: ω²γ/(…) stands where a mass would.
        _, below = _spring_and_rest(view.omega, x)
        return (x[0] * view.omega**2 / below).astype(np.complex128), 0.0

    def of_own_jumps(self, view: View, place: Place, x: Sequence[float]) -> Complex128:
        # −ω²x + (2/T)(jωΔx + Δv) with x from the body's own balance, as of an extra mode's mass.
        w = view.omega
        spring, below = _spring_and_rest(w, x)
        pattern, size = self.pattern(view.structure, place, x), float(np.sqrt(max(x[0], 0.0)))
        moved = along(pattern, view.base) * size * w**2 / below
        bound = 2.0 * np.array([np.linalg.norm(moved), np.linalg.norm(w * moved)])
        jumps = np.stack((1j * w * float(np.exp(2 * x[1])), spring), axis=-1) * bound
        out: Complex128 = (2.0 * size / view.record.span) * jumps / below[:, None]
        out[0] *= 0.5
        return out

    def values(self, x: Sequence[float], place: Place) -> dict[str, float]:
        own = float(np.exp(2 * x[1]))
        direction = unit_direction(np.asarray(x[3:], dtype=float))
        shares = np.linalg.solve(self._inertia, direction)
        scale = 1.0 / float(shares[np.argmax(np.abs(shares))])
        shares = shares * scale
        total = scale**2 / max(float(x[0]), 1e-300)
        out = {
            "mass": total - float(shares @ self._inertia @ shares),
            "stiffness": total * own,
            "damping_ratio": float(np.exp(x[2])),
        }
        if self._axes > 1:
            out |= {f"{SHARE}{i + 1}": float(s) for i, s in enumerate(shares)}
        return out

    def vector(self, p: Mapping[str, float]) -> list[float]:
        total, force = moved_by_base(p, self._inertia)
        own = 0.5 * float(np.log(p["stiffness"] / total))
        size = float(force @ force) / total
        return [size, own, float(np.log(p["damping_ratio"])), *angles_of(force).tolist()]

    def known(self, term: EffectTerm) -> BaseCompliance:
        count = sum(name.startswith(SHARE) for name in term.parameters)
        return _law_of(max(count, 1))

    def beyond(self, views: Sequence[View], place: Place, x: Sequence[float]) -> bool:
        # No body is so light that the loads on it weigh more than all that moves.
        direction = unit_direction(np.asarray(x[3:], dtype=float))
        inertia = _inertia_in(views[0])
        if direction.size != inertia.shape[0]:
            return False
        if float(x[0] * direction @ np.linalg.solve(inertia, direction)) > 1.0 - LEAST_FREE:
            return True
        mass = BaseCompliance(self._axes, inertia).values(x, place)["mass"]
        return mass > HEAVIEST * float(np.diag(inertia).max())

    def simulation(self, at: ModelPlace) -> Sequence[Element]:
        chains = at.chains
        inertia = load_inertia(chains)
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


def _spring_and_rest(omega: Float64, x: Sequence[float]) -> tuple[Complex128, Complex128]:
    """(F,) ω₀² + 2jζω₀ω and that less ω²."""
    own, zeta = float(np.exp(x[1])), float(np.exp(x[2]))
    spring: Complex128 = (own**2 + 2j * zeta * own * omega).astype(np.complex128)
    below: Complex128 = spring - omega**2
    return spring, below


def _inertia_in(view: View) -> Float64:
    """(M, M) inertia of the loads in the linear plant of a view."""
    return np.diag(view.masses[list(view.structure.end_dofs)]) + view.couplings


def _directions(inertia: Float64) -> list[Float64]:
    """Forces (M,) on the loads to start from: the body moves as one of the joints does, or as all of them do;
    it shakes one load alone, or two of them alike or against each other."""
    count, own = inertia.shape[0], np.diag(np.diag(inertia))
    out = [*own]
    if np.abs(inertia - own).max() > 0.0:
        out += [*inertia]
    out += [own[i] + sign * own[j] for i in range(count) for j in range(i) for sign in (1.0, -1.0)]
    if count > 2:
        out.append(inertia.sum(axis=1))
    return out
