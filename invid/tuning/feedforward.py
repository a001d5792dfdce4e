"""Torque that the motion itself asks for: inertia, and friction and weight as far as their causes are
named."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from invid.exchange.linear_plant import LinearPlant
from invid.model.document import EffectTerm, Model
from invid.numerics.arrays import Float64

TURNOVER = 0.02
"""Share of the fastest commanded speed within which dry friction is turned over: a command that stands still
must not chatter."""


@dataclass(frozen=True)
class Feedforward:
    """Torque J q̈ + f_v q̇ + f_c sgn(q̇) + offset + weight·sin(q + angle) of one axis, as the drive
    commands it.

    ``inertia`` [kg·m² or kg], ``viscous`` [N·m·s/rad], ``dry``, ``offset``, ``weight`` [N·m], ``angle``
    [rad], ``breakaway`` [N·m]: dry friction at the slowest speed where it is larger (Stribeck), else equal
    to ``dry``. ``named`` are the causes that went in, ``left_out`` those that did not and why, in sentences.
    """

    inertia: float = 0.0
    inertia_std: float | None = None
    viscous: float = 0.0
    dry: float = 0.0
    breakaway: float = 0.0
    offset: float = 0.0
    weight: float = 0.0
    angle: float = 0.0
    named: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()

    def torque(self, position: Float64, velocity: Float64, acceleration: Float64) -> Float64:
        """(n,) torque for a commanded motion (n,)."""
        fastest = float(np.abs(velocity).max(initial=0.0)) or 1.0
        direction = np.tanh(velocity / (TURNOVER * fastest))
        result: Float64 = (
            self.inertia * acceleration
            + self.viscous * velocity
            + self.dry * direction
            + self.offset
            + self.weight * np.sin(position + self.angle)
        )
        return result


NONE = Feedforward(0.0, None)
ANSWERS: dict[str, Callable[[Callable[[str], float]], dict[str, float]]] = {
    "coulomb_friction": lambda of: {"dry": of("torque"), "breakaway": of("torque")},
    "presliding_friction": lambda of: {"dry": of("torque"), "breakaway": of("torque")},
    "stribeck_friction": lambda of: {"dry": of("coulomb"), "breakaway": max(of("static"), of("coulomb"))},
    "viscous_friction": lambda of: {"viscous": of("coefficient")},
    "asymmetric_friction": lambda of: {
        "dry": (of("coulomb_positive") + of("coulomb_negative")) / 2.0,
        "breakaway": (of("coulomb_positive") + of("coulomb_negative")) / 2.0,
        "offset": (of("coulomb_positive") - of("coulomb_negative")) / 2.0,
        "viscous": (of("viscous_positive") + of("viscous_negative")) / 2.0,
    },
    "torque_offset": lambda of: {"offset": of("torque")},
    "gravity": lambda of: {"weight": of("torque"), "angle": of("angle")},
}
"""What the parameters of a cause add to a feedforward; no other cause is answered by one."""


def feedforward(
    model: Model, plant: LinearPlant, axis: int, inertia: float, doubtful: Sequence[EffectTerm]
) -> Feedforward:
    """Feedforward of an axis. ``inertia`` as the drive has to command it; ``doubtful`` effects are left out
    unless every candidate is friction, which describes the same force."""
    name, gain = model.axes[axis], float(plant.gain[axis])
    total = dict.fromkeys(("viscous", "dry", "breakaway", "offset", "weight", "angle"), 0.0)
    named, left_out = [], []
    for term in (t for t in model.effects if t.axis == name and t.cause in ANSWERS):
        if term in doubtful and "friction" not in term.cause:
            left_out.append(f"{term.cause}: its cause is open")
        elif term.cause == "gravity" and total["weight"]:
            left_out.append(f"{term.cause} on {term.element}: one weight an axis")
        else:
            named.append(term.cause)
            for key, value in ANSWERS[term.cause](term.value).items():
                total[key] += value if key == "angle" else value / gain
    std = float(np.linalg.norm(model.std.masses[axis])) / gain
    return Feedforward(
        inertia, std if np.isfinite(std) else None, **total, named=tuple(named), left_out=tuple(left_out)
    )
