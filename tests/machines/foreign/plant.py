"""One rigid axis: inertia, load, friction, brake, a prop under it, hard stops; RK4."""

import math
from dataclasses import dataclass

STEP_S = 5e-4
STUCK = 2e-4
"""Speed below which dry friction and a closed brake hold [rad/s]."""
CURRENT_S = 8e-4
"""Time constant of the current loop."""


@dataclass
class Plant:
    """State and constants, SI; the load pulls towards negative positions, horizontal at zero."""

    inertia: float = 1.0
    load: float = 0.0
    upright: float = 0.0
    """A mass above its pivot: torque per radian that drives it away from zero."""
    viscous: float = 0.3
    coulomb: float = 0.1
    brake: float | None = None
    """Seconds until it has closed; none: no brake."""
    opens: float = 0.02
    """Seconds until it has opened."""
    brake_torque: float = 60.0
    low: float = -1.2
    high: float = 1.5
    propped: bool = False
    """Something stands under it, until its drive is first enabled."""

    q: float = 0.0
    v: float = 0.0
    torque: float = 0.0
    closed: bool = True
    prop: float | None = None
    """Where what stands under it is [rad]."""
    worn: bool = False
    """Closes, and does not hold."""

    def __post_init__(self) -> None:
        if self.propped:
            self.prop = self.q

    @property
    def is_braked(self) -> bool:
        """Whether a brake holds it now."""
        return self.brake is not None and self.closed and not self.worn

    def force(self, q: float) -> float:
        """Torque of load and balance at a place."""
        return self.upright * math.sin(q) - self.load * math.cos(q)

    def step(self, wanted: float | None) -> None:
        """One step with the torque that the drive wants; ``None``: its power stage is off."""
        h = STEP_S
        begin = self.torque
        if wanted is None:
            self.torque = begin = 0.0
        else:
            self.torque = wanted + (begin - wanted) * math.exp(-h / CURRENT_S)
        mean = 0.5 * (begin + self.torque)
        dry = self.coulomb + (self.brake_torque if self.is_braked else 0.0)
        q, v = self.q, self.v
        push = mean + self.force(q)
        if abs(v) < STUCK and (abs(push) <= dry or (self._stands_on_prop(q) and push < dry)):
            self.v = 0.0
            return
        drag = math.copysign(dry, v if abs(v) >= STUCK else push)
        a1 = self._accelerates(mean, q, v, drag)
        a2 = self._accelerates(mean, q + 0.5 * h * v, v + 0.5 * h * a1, drag)
        a3 = self._accelerates(mean, q + 0.5 * h * v + 0.25 * h * h * a1, v + 0.5 * h * a2, drag)
        a4 = self._accelerates(mean, q + h * v + 0.5 * h * h * a2, v + h * a3, drag)
        self.q = q + h * v + h * h / 6.0 * (a1 + a2 + a3)
        self.v = v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        if v * self.v < 0.0 and abs(push) <= dry:
            self.v = 0.0
        floor = self.low if self.prop is None else max(self.low, self.prop)
        if not floor <= self.q <= self.high:
            self.q = min(max(self.q, floor), self.high)
            self.v = 0.0

    def _stands_on_prop(self, q: float) -> bool:
        return self.prop is not None and q <= self.prop + 1e-9

    def _accelerates(self, torque: float, q: float, v: float, drag: float) -> float:
        return (torque + self.force(q) - self.viscous * v - drag) / self.inertia
